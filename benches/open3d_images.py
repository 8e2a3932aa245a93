"""Conversion of frames to images and cameras of Open3D's pipelines."""

from __future__ import annotations

from typing import Any

import numpy as np

from scanloom.stages._open3d import import_open3d
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame

# Grey level for pipelines that require colours if a frame has none.
_GREY = 128


def read_images(frame: Frame) -> tuple[DepthImage, ColorImage]:
    """Read a frame's depth and the colours registered to it.

    Returns depth (h, w) in metres and colours (h, w, 3) uint8, which are grey if the frame has none.

    Raises
    ------
    ValueError
        If the frame has no depth.
    """
    depth = read_depth(frame)
    if depth is None:
        raise ValueError(f"frame {frame.name} has no depth")
    if frame.color is None:
        return depth, np.full((*depth.shape, 3), _GREY, np.uint8)
    return depth, read_color_aligned_to_depth(frame, depth)


def make_legacy_image(depth: DepthImage, color: ColorImage, truncation: float) -> Any:
    """Make a legacy RGBDImage of grey intensities, depth truncated at `truncation` metres."""
    o3d = import_open3d()
    return o3d.geometry.RGBDImage.create_from_color_and_depth(
        o3d.geometry.Image(color),
        o3d.geometry.Image(depth),
        depth_scale=1.0,
        depth_trunc=truncation,
    )


def make_legacy_camera(camera: Camera) -> Any:
    """Convert camera intrinsics for the legacy pipelines."""
    return import_open3d().camera.PinholeCameraIntrinsic(
        camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy
    )
