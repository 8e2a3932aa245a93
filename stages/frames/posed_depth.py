"""Depth map of a frame with its pose, filtered for measuring and fusing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.depth_filter import OrientedDepth, orient_depth
from scanloom.stages.frames.rigid_pose import require_rigid_pose
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING, SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, to_pinhole

# Maximum angle between the line of sight and the surface normal, degrees: with several frames, and with a
# single frame. At grazing angles other frames see the surface better.
MAX_ANGLE_DEG, MAX_ANGLE_SINGLE_FRAME_DEG = 87.0, 89.0


@dataclass(frozen=True, kw_only=True)
class DepthLimits:
    """Limits of the depth to read; see the parameters of `fuse` with the same names."""

    min_depth: float
    max_depth: float
    max_jump: float
    max_angle: float


@dataclass(frozen=True, eq=False)
class PosedDepth:
    """Filtered depth map of a frame, with the camera pose.

    Attributes
    ----------
    surface : depth within the limits, filtered, without lens distortion.
    camera : pinhole camera of the depth map.
    pose : (4, 4) world_from_camera.
    valid_pixel_count : number of pixels with depth before filtering.
    """

    surface: OrientedDepth
    camera: Camera
    pose: Pose
    valid_pixel_count: int

    def unproject_grid(self, step: int) -> NDArray[np.float64]:
        """Unproject every `step`-th row and column to world points (n, 3)."""
        rows, columns = np.nonzero(self.surface.depth[::step, ::step])
        return self.unproject_to_world(rows * step, columns * step)

    def unproject_to_world(self, rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[np.float64]:
        """Unproject pixels to world points (n, 3)."""
        points = self.unproject_to_camera(rows, columns).astype(np.float64)
        return np.asarray(points @ self.pose[:3, :3].T + self.pose[:3, 3])

    def unproject_to_camera(self, rows: NDArray[Any], columns: NDArray[Any]) -> NDArray[np.float32]:
        """Unproject pixels to points (n, 3) in camera axes."""
        z = self.surface.depth[rows, columns]
        x = ((columns - self.camera.cx) / self.camera.fx).astype(np.float32)
        y = ((rows - self.camera.cy) / self.camera.fy).astype(np.float32)
        return np.stack([x * z, y * z, z], axis=1)


def read_posed_depth(frame: Frame, limits: DepthLimits) -> PosedDepth:
    """Read and filter the depth map of a posed frame.

    Raises
    ------
    InputError
        If the frame has no pose or no depth, or the depth file cannot be read.
    """
    pose = require_rigid_pose(frame)
    depth = read_depth(frame)
    if depth is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", DiagnosticLocation(frame=frame.name))
    valid = int(np.count_nonzero(depth))
    camera = to_pinhole(frame.camera)
    oriented = orient_depth(
        depth,
        camera,
        max_jump=limits.max_jump,
        max_angle=limits.max_angle,
        min_depth=limits.min_depth,
        max_depth=limits.max_depth,
    )
    if not oriented.depth.any():
        message = (
            "no pixel has a depth."
            if valid == 0
            else "no depth is within the limits of distance, depth jumps and angle."
        )
        raise InputError(SCAN_FRAMES_SKIPPED, message, DiagnosticLocation(frame=frame.name))
    return PosedDepth(oriented, camera, pose, valid)
