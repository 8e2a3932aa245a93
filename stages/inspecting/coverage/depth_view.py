"""Depth map and pose of a frame, with a coarse depth map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.registration.codes import SCAN_DEPTH_MOSTLY_EMPTY
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_depth, read_valid_pixels
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, DepthImage, Frame, to_pinhole

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]

# Longer side of the coarse depth map, pixels.
_COARSE_SIDE_PX = 160
# Maximum distance over which gaps in depth are filled, as ratio of the coarse map's width.
_MAX_FILL_RATIO = 0.1
# Number of directions (of four) in which a gap pixel needs some depth in its row or column.
_MIN_SIDES_WITH_DEPTH = 4


@dataclass(frozen=True, eq=False)
class DepthView:
    """Depth measurements and pose of a frame.

    Attributes
    ----------
    name : name of the frame.
    camera : camera model without distortion.
    position : (3,) float64, camera position in world coordinates, metres.
    rotation, translation : (3, 3) and (3,) float32, transform from coordinates relative to `origin` to camera
        coordinates.
    depth : (h, w) float32, metres; 0 if missing.
    coarse_depth : (h', w') float32, minimum depth of `downsampling` × `downsampling` pixels; 0 if missing in
        all of them.
    filled_depth : `coarse_depth` with small gaps filled from the nearest pixel; infinite where a mask
        excludes the scene.
    downsampling : downsampling factor, pixels.
    """

    name: str
    camera: Camera
    position: Floats
    rotation: Singles
    translation: Singles
    depth: DepthImage
    coarse_depth: DepthImage
    filled_depth: DepthImage
    downsampling: int

    def project_points(self, points: Singles) -> tuple[Singles, Singles, Singles]:
        """Project points (n, 3) to columns, rows and depths (n,).

        The points are relative to `origin`.
        """
        x, y, z = self.rotation @ points.T + self.translation[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            columns = np.float32(self.camera.fx) * x / z + np.float32(self.camera.cx)
            rows = np.float32(self.camera.fy) * y / z + np.float32(self.camera.cy)
        return columns, rows, z

    def unproject_pixels(self, columns: NDArray[np.int64], rows: NDArray[np.int64]) -> Singles:
        """Unproject pixels to points (3, k) in camera coordinates, metres."""
        camera = self.camera
        z = self.depth[rows, columns]
        across = (columns.astype(np.float32) - np.float32(camera.cx)) / np.float32(camera.fx)
        down = (rows.astype(np.float32) - np.float32(camera.cy)) / np.float32(camera.fy)
        return np.stack([across * z, down * z, z])

    def find_pixels(
        self, columns: Singles, rows: Singles, z: Singles, downsampling: int = 1
    ) -> tuple[NDArray[np.intp], NDArray[np.int64]]:
        """Find the points inside the image, and their flat pixel indices.

        Parameters
        ----------
        columns, rows, z : (n,) projected points.
        downsampling : 1 for indices into `depth`; the view's `downsampling` for `coarse_depth`.
        """
        width, height = self.camera.width, self.camera.height
        (inside,) = np.nonzero(
            (z > 0) & (columns > -0.5) & (rows > -0.5) & (columns < width - 0.5) & (rows < height - 0.5)
        )
        across = (columns[inside] + np.float32(0.5)).astype(np.int64) // downsampling
        down = (rows[inside] + np.float32(0.5)).astype(np.int64) // downsampling
        return inside, down * math.ceil(width / downsampling) + across


def read_view(frame: Frame, origin: Floats) -> DepthView:
    """Read the depth map and pose of a frame.

    Parameters
    ----------
    frame : frame with depth and pose.
    origin : (3,) origin for point coordinates in metres, close to the points so that float32 suffices.

    Raises
    ------
    InputError
        If the frame has no pose or no depth, or its file cannot be read.
    """
    pose = require_rigid_pose(frame)
    depth = read_depth(frame)
    if depth is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", DiagnosticLocation(frame=frame.name))
    if not depth.any():
        raise InputError(
            SCAN_DEPTH_MOSTLY_EMPTY, "no pixel has a depth.", DiagnosticLocation(frame=frame.name)
        )
    to_camera = invert_pose(pose)
    step = max(1, round(max(depth.shape) / _COARSE_SIDE_PX))
    coarse = _downsample_min(depth, step)
    return DepthView(
        name=frame.name,
        camera=to_pinhole(frame.camera),
        position=pose[:3, 3],
        rotation=to_camera[:3, :3].astype(np.float32),
        translation=(to_camera[:3, :3] @ origin + to_camera[:3, 3]).astype(np.float32),
        depth=depth,
        coarse_depth=coarse,
        filled_depth=_exclude_masked(_fill_gaps(coarse), frame, step),
        downsampling=step,
    )


def _exclude_masked(filled_depth: DepthImage, frame: Frame, downsampling: int) -> DepthImage:
    """Set coarse depth to infinity where a mask excludes all pixels."""
    if frame.mask is None:
        return filled_depth
    mask = read_valid_pixels(frame).astype(np.float32)
    is_shown = _downsample_min(np.where(mask > 0, mask, np.float32(2)), downsampling) < 2
    return np.asarray(np.where(is_shown, filled_depth, np.inf), np.float32)


def _downsample_min(depth: DepthImage, downsampling: int) -> DepthImage:
    """Downsample depth by the minimum of `downsampling` × `downsampling` pixels.

    Blocks without any depth become 0.
    """
    rows, columns = (math.ceil(size / downsampling) for size in depth.shape)
    padded = np.full((rows * downsampling, columns * downsampling), np.inf, np.float32)
    padded[: depth.shape[0], : depth.shape[1]] = np.where(depth > 0, depth, np.float32(np.inf))
    least = padded.reshape(rows, downsampling, columns, downsampling).min(axis=(1, 3))
    return np.asarray(np.where(np.isfinite(least), least, 0), np.float32)


def _fill_gaps(coarse: DepthImage) -> DepthImage:
    """Fill gaps in coarse depth from the nearest pixel.

    Glass and black surfaces return no depth. Space in front of them counts as observed up to the depth of
    their surroundings. Missing depth beyond a silhouette is not filled, because there may be no surface at
    all.
    """
    import cv2

    known = coarse > 0
    if known.all():
        return coarse
    sides = sum(
        np.maximum.accumulate(known[turn], axis=axis)[turn].astype(np.int8)
        for axis, turn in ((0, np.s_[:]), (0, np.s_[::-1]), (1, np.s_[:]), (1, np.s_[:, ::-1]))
    )
    missing = (~known).astype(np.uint8)
    away, labels = cv2.distanceTransformWithLabels(missing, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    depth = np.zeros(int(labels.max()) + 1, np.float32)
    depth[labels[known]] = coarse[known]
    is_gap = (away <= _MAX_FILL_RATIO * coarse.shape[1]) & (sides >= _MIN_SIDES_WITH_DEPTH)
    return np.asarray(np.where(known | is_gap, depth[labels], 0), np.float32)
