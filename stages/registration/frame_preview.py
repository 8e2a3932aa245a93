"""Downscaled previews of frames for comparison pixel by pixel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.frames.projection import unproject
from scanloom.stages.registration.view import downscale_depth
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Frame, scale_camera, to_pinhole

# Maximum width, pixels; wider frames are downscaled, since masks need no finer resolution.
_MAX_WIDTH_PX = 320
# Maximum depth difference on one surface, relative and in metres: noise, and edges shifted by a pixel.
_TOLERANCE_RATIO, _TOLERANCE_M = 0.015, 0.002


@dataclass(frozen=True, eq=False)
class FramePreview:
    """Downscaled depth and colour of a frame.

    Attributes
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    color : (h, w, 3) float32, 8-bit levels, smoothed; None without colour.
    camera : camera of both images, without distortion.
    """

    depth: NDArray[np.float32]
    color: NDArray[np.float32] | None
    camera: Camera

    def unproject_pixels(self) -> NDArray[np.float64]:
        """Unproject all pixels to points (h, w, 3) in camera axes.

        Pixels without depth give the origin.
        """
        rows, columns = np.mgrid[: self.camera.height, : self.camera.width]
        return unproject(columns, rows, self.depth, self.camera)


def compute_depth_tolerance(depth: NDArray[np.float32]) -> NDArray[np.float32]:
    """Compute the maximum depth difference on one surface, metres."""
    return np.asarray(_TOLERANCE_RATIO * depth + _TOLERANCE_M, np.float32)


def read_preview(frame: Frame) -> FramePreview | None:
    """Read the preview of a frame; None if the frame is unreadable."""
    import cv2

    try:
        depth = read_depth(frame)
        if depth is None:
            return None
        shown = None if frame.color is None else read_color_aligned_to_depth(frame, depth)
    except InputError:
        return None
    step = max(-(-frame.camera.width // _MAX_WIDTH_PX), 1)
    small = downscale_depth(depth, step)
    height, width = small.shape
    color = None
    if shown is not None:
        whole = shown[: height * step, : width * step]
        shrunk = cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)
        color = np.asarray(cv2.GaussianBlur(shrunk.astype(np.float32), (0, 0), 0.8), np.float32)
    camera = scale_camera(to_pinhole(frame.camera), frame.camera.width // step, frame.camera.height // step)
    return FramePreview(small, color, camera)


def read_previews(
    frames: Sequence[Frame] | Mapping[int, Frame], frame_indices: Sequence[int]
) -> dict[int, FramePreview]:
    """Read the previews of frames at given indices.

    Unreadable frames, and frames of an unusual size, are missing from the result.
    """
    threads = get_worker_count()
    previews = map_ordered(
        read_preview, [frames[n] for n in frame_indices], threads=threads, max_pending=threads
    )
    found = {n: look for n, look in zip(frame_indices, previews, strict=True) if look is not None}
    shapes = [look.depth.shape for look in found.values()]
    usual = max(shapes, key=shapes.count) if shapes else None
    return {n: look for n, look in found.items() if look.depth.shape == usual}
