"""A posed frame with depth, read and filtered, ready to be measured or fused."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.fusion.depth_filter import Surface, surface
from stages.scans.images import read_color, read_depth
from stages.scans.scan import Camera, ColorImage, DepthImage, Frame, Pose, pinhole, scaled

# Poses come from text with few digits and from trackers that drift off rotation a little.
_RIGID_TOLERANCE = 1e-2


@dataclass(frozen=True, kw_only=True)
class DepthLimits:
    """Which depth is used: see the parameters of `fuse`, which have the same names."""

    min_depth: float
    max_depth: float
    max_jump: float
    max_angle: float


@dataclass(frozen=True, eq=False)
class PosedDepth:
    """A frame that was read.

    Attributes
    ----------
    surface : its depth within the limits, filtered, without lens distortion.
    camera : without distortion.
    pose : (4, 4) world_from_camera.
    valid : number of pixels that had a depth.
    """

    surface: Surface
    camera: Camera
    pose: Pose
    valid: int

    def points(self, step: int) -> NDArray[np.float64]:
        """Return the world points (n, 3) of the pixels in every `step`-th row and column."""
        rows, columns = np.nonzero(self.surface.depth[::step, ::step])
        return self.world_points(rows * step, columns * step)

    def world_points(self, rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[np.float64]:
        """Return the points (n, 3) of some pixels in the world."""
        points = self.camera_points(rows, columns).astype(np.float64)
        return np.asarray(points @ self.pose[:3, :3].T + self.pose[:3, 3])

    def camera_points(self, rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[np.float32]:
        """Return the points (n, 3) of some pixels in camera axes."""
        z = self.surface.depth[rows, columns]
        x = ((columns - self.camera.cx) / self.camera.fx).astype(np.float32)
        y = ((rows - self.camera.cy) / self.camera.fy).astype(np.float32)
        return np.stack([x * z, y * z, z], axis=1)


def read_posed_depth(frame: Frame, limits: DepthLimits) -> PosedDepth:
    """Read a frame's depth.

    Raises
    ------
    InputError
        If the frame has no pose or no depth, or its file cannot be read.
    """
    pose = rigid_pose(frame)
    depth = read_depth(frame)
    if depth is None:
        raise InputError("there is no depth map.", f"frame {frame.name}")
    valid = int(np.count_nonzero(depth))
    camera = pinhole(frame.camera)
    seen = surface(
        depth,
        camera,
        max_jump=limits.max_jump,
        max_angle=limits.max_angle,
        min_depth=limits.min_depth,
        max_depth=limits.max_depth,
    )
    if not seen.depth.any():
        what = "no pixel has a depth" if valid == 0 else "no pixel's depth is within the limits"
        raise InputError(f"{what}.", f"frame {frame.name}")
    return PosedDepth(seen, camera, pose, valid)


def read_matching_color(frame: Frame, depth: DepthImage) -> ColorImage:
    """Read a frame's colour image in the size and geometry of its depth map.

    Parameters
    ----------
    frame : with colour.
    depth : (h, w) metres, of the frame; where it is 0, a colour means little if the cameras stand apart.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.
    """
    import cv2

    color = read_color(frame)
    if color is None:
        raise InputError("there is no colour image, while other frames have one.", f"frame {frame.name}")
    size = (frame.camera.width, frame.camera.height)
    if frame.color_camera is not None:
        return _seen_by_depth(color, frame, frame.color_camera, depth)
    if (color.shape[1], color.shape[0]) != size:
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    return np.ascontiguousarray(color)


def _seen_by_depth(color: ColorImage, frame: Frame, camera: Camera, depth: DepthImage) -> ColorImage:
    """Return the colour at the pixels of the depth map, looked up through the colour camera."""
    import cv2

    # Sampled at the depth map's spacing: what is finer is averaged first.
    spacing = (camera.fx / camera.width * color.shape[1]) / frame.camera.fx
    if spacing > 1:
        smaller = (max(round(color.shape[1] / spacing), 1), max(round(color.shape[0] / spacing), 1))
        color = np.asarray(cv2.resize(color, smaller, interpolation=cv2.INTER_AREA), np.uint8)
    to = scaled(camera, color.shape[1], color.shape[0])
    rows, columns = np.mgrid[: depth.shape[0], : depth.shape[1]]
    z = np.where(depth > 0, depth, 1).astype(np.float64)
    x, y = ((columns - frame.camera.cx) / frame.camera.fx * z, (rows - frame.camera.cy) / frame.camera.fy * z)
    points = np.stack([x, y, z])
    if frame.color_from_depth is not None:
        pose = np.asarray(frame.color_from_depth, np.float64)
        points = np.tensordot(pose[:3, :3], points, 1) + pose[:3, 3, None, None]
    behind = points[2] <= 0
    points[2][behind] = 1
    across = np.where(behind, -1, points[0] / points[2] * to.fx + to.cx).astype(np.float32)
    down = np.where(behind, -1, points[1] / points[2] * to.fy + to.cy).astype(np.float32)
    return np.asarray(
        cv2.remap(color, across, down, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.uint8
    )


def rigid_pose(frame: Frame) -> Pose:
    """Return a frame's pose, or raise InputError where it has none, or one that is no rotation and shift."""
    if frame.world_from_camera is None:
        raise InputError("there is no camera pose.", f"frame {frame.name}")
    pose = np.asarray(frame.world_from_camera, np.float64)
    rotation = pose[:3, :3]
    if not np.isfinite(pose).all():
        raise InputError("the camera pose is not finite.", f"frame {frame.name}")
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if off > _RIGID_TOLERANCE or np.linalg.det(rotation) < 0:
        raise InputError("the camera pose is not a rotation and a shift.", f"frame {frame.name}")
    return pose
