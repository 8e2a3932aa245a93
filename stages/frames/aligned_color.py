"""Colour image of a frame, resampled to the pixels of its depth map."""

from __future__ import annotations

import numpy as np

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.projection import project
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, scale_camera


def read_color_aligned_to_depth(frame: Frame, depth: DepthImage) -> ColorImage:
    """Read the colour of a frame at the pixels of its depth map.

    Parameters
    ----------
    frame : frame with a colour image.
    depth : (h, w) metres, depth map of the frame. If the colour camera and the depth camera have different
        positions, the colour of a pixel without depth is a guess.

    Raises
    ------
    InputError
        If the frame has no colour image, or its file cannot be read.
    """
    import cv2

    color = read_color(frame)
    if color is None:
        raise InputError(
            FRAME_IMAGE_MISSING,
            "there is no colour image, while other frames have one.",
            DiagnosticLocation(frame=frame.name),
        )
    size = (frame.camera.width, frame.camera.height)
    if frame.color_camera is not None:
        return _reproject_color(color, frame, frame.color_camera, depth)
    if (color.shape[1], color.shape[0]) != size:
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return np.ascontiguousarray(color)


def _reproject_color(color: ColorImage, frame: Frame, camera: Camera, depth: DepthImage) -> ColorImage:
    """Reproject the colour image to the pixels of the depth map."""
    import cv2

    # Photos with smaller pixels than the depth map are averaged first, against aliasing.
    spacing = (camera.fx / camera.width * color.shape[1]) / frame.camera.fx
    if spacing > 1:
        smaller = (max(round(color.shape[1] / spacing), 1), max(round(color.shape[0] / spacing), 1))
        color = np.asarray(cv2.resize(color, smaller, interpolation=cv2.INTER_AREA), np.uint8)
    to = scale_camera(camera, color.shape[1], color.shape[0])
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    z = np.where(depth > 0, depth, 1).astype(np.float64)
    x, y = ((columns - frame.camera.cx) / frame.camera.fx * z, (rows - frame.camera.cy) / frame.camera.fy * z)
    points = np.stack([x, y, z])
    if frame.color_from_depth is not None:
        pose = np.asarray(frame.color_from_depth, np.float64)
        points = np.tensordot(pose[:3, :3], points, 1) + pose[:3, 3, None, None]
    across, down = (
        np.where(np.isnan(positions), -1, positions).astype(np.float32)
        for positions in project(np.moveaxis(points, 0, -1), to)
    )
    return np.asarray(
        cv2.remap(color, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )
