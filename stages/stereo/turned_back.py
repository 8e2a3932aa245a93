"""Correction of images that are upside down relative to their poses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_mask
from scanloom.stages.scans.model.prefetch import read_ahead
from scanloom.stages.scans.model.scan import Frame, Packed, Scan
from scanloom.stages.scans.model.threads import threads_to_use
from scanloom.stages.stereo.codes import DEPTH_IMAGES_TURNED
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.turned import Corners, corners, turned
from scanloom.stages.stereo.view_images import color_of, grey_of


def turned_back(
    scan: Scan, views: Sequence[PosedView], pairs: Sequence[tuple[int, int]], params: DepthParams
) -> Scan:
    """Rotate upside-down images of a scan by 180°, with a warning."""

    def read(frame: Frame) -> Corners | None:
        try:
            return corners(grey_of(color_of(frame)))
        except InputError:
            return None  # reported when the view is measured

    threads = params.threads or threads_to_use()
    found = list(read_ahead(read, scan.frames, threads=threads, ahead=threads + 2))
    places = [at for at, is_turned in enumerate(turned(views, found, pairs)) if is_turned]
    if not places:
        return scan
    frames = list(scan.frames)
    for at in places:
        frames[at] = replace(
            frames[at],
            color=_upside_down(frames[at], frames[at].color, read_color),
            mask=_upside_down(frames[at], frames[at].mask, read_mask),
        )
    emit(
        DEPTH_IMAGES_TURNED.warning(
            "{count} images are upside down relative to their poses and were rotated by 180 degrees; the "
            "first is {first}",
            count=len(places),
            first=frames[places[0]].name,
        )
    )
    return replace(scan, frames=frames)


def _upside_down(
    frame: Frame,
    source: Path | Packed | NDArray[np.uint8] | None,
    read: Callable[[Frame], NDArray[np.uint8] | None],
) -> Packed | NDArray[np.uint8] | None:
    """Rotate an image of a frame by 180°.

    An image in a file is read and rotated on each access.
    """
    if source is None:
        return None

    def load() -> NDArray[np.uint8]:
        image = read(frame)
        if image is None:
            raise InputError(FRAME_IMAGE_MISSING, "the image is missing.", Where(frame=frame.name))
        return np.ascontiguousarray(image[::-1, ::-1])

    if isinstance(source, np.ndarray):
        return load()
    return Packed(source if isinstance(source, Path) else source.file, f"{frame.name}, turned", load)
