"""Correction of images that are upside down relative to their poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_mask
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import Frame, PackedImage, Scan
from scanloom.stages.scans.model.threads import get_thread_count
from scanloom.stages.stereo.codes import DEPTH_IMAGES_TURNED
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.upside_down_detection import ImageCorners, detect_corners, find_upside_down
from scanloom.stages.stereo.view_images import convert_to_grey, read_view_color


def rotate_upside_down(
    scan: Scan, views: Sequence[PosedView], pairs: Sequence[tuple[int, int]], params: DepthParams
) -> Scan:
    """Rotate upside-down images of a scan by 180°, with a warning."""

    def detect_frame_corners(frame: Frame) -> ImageCorners | None:
        try:
            return detect_corners(convert_to_grey(read_view_color(frame)))
        except InputError:
            return None  # reported when the view is measured

    threads = params.threads or get_thread_count()
    found = list(map_ordered(detect_frame_corners, scan.frames, threads=threads, max_pending=threads + 2))
    indices = [at for at, is_turned in enumerate(find_upside_down(views, found, pairs)) if is_turned]
    if not indices:
        return scan
    frames = list(scan.frames)
    for at in indices:
        frames[at] = replace(
            frames[at],
            color=_rotate_image(frames[at], frames[at].color, read_color),
            mask=_rotate_image(frames[at], frames[at].mask, read_mask),
        )
    emit(
        DEPTH_IMAGES_TURNED.warning(
            "{count} images are upside down relative to their poses and were rotated by 180 degrees; the "
            "first is {first}",
            count=len(indices),
            first=frames[indices[0]].name,
        )
    )
    return replace(scan, frames=frames)


def _rotate_image(
    frame: Frame,
    source: Path | PackedImage | NDArray[np.uint8] | None,
    read: Callable[[Frame], NDArray[np.uint8] | None],
) -> PackedImage | NDArray[np.uint8] | None:
    """Rotate an image of a frame by 180°.

    An image in a file is read and rotated on each access.
    """
    if source is None:
        return None

    def load_rotated() -> NDArray[np.uint8]:
        image = read(frame)
        if image is None:
            raise InputError(
                FRAME_IMAGE_MISSING, "the image is missing.", DiagnosticLocation(frame=frame.name)
            )
        return np.ascontiguousarray(image[::-1, ::-1])

    if isinstance(source, np.ndarray):
        return load_rotated()
    return PackedImage(
        source if isinstance(source, Path) else source.file, f"{frame.name}, turned", load_rotated
    )
