"""Single views with poses and their depth ranges."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.projection import project, unproject
from scanloom.stages.scans.codes import POSE_INVALID, POSE_MISSING
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, to_pinhole

# Maximum plausible coordinate of a camera centre, metres.
_MAX_COORDINATE_M = 1e9


@dataclass(frozen=True, eq=False)
class PosedView:
    """Undistorted view with its pose and depth range.

    Attributes
    ----------
    camera : camera of the undistorted image.
    world_from_camera : (4, 4) float64, metres.
    near, far : depth range along the optical axis, metres.
    """

    camera: Camera
    world_from_camera: Pose
    near: float
    far: float

    @property
    def centre(self) -> NDArray[np.float64]:
        """Return the camera centre, (3,) metres, world."""
        return np.asarray(self.world_from_camera[:3, 3])

    @property
    def middle_depth(self) -> float:
        """Return the geometric mean of the depth range, metres."""
        return math.sqrt(self.near * self.far)

    def compute_rays(self, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return rays (…, 3) through pixels, with z = 1, camera axes."""
        return unproject(columns, rows, 1, self.camera)

    def compute_ray_grid(self, count: int) -> NDArray[np.float64]:
        """Return rays (count², 3) on a regular image grid, including the corners."""
        columns, rows = np.meshgrid(
            np.linspace(-0.5, self.camera.width - 0.5, count),
            np.linspace(-0.5, self.camera.height - 0.5, count),
        )
        return self.compute_rays(columns.ravel(), rows.ravel())

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Transform points (…, 3) from camera to world coordinates."""
        return np.asarray(points @ self.world_from_camera[:3, :3].T + self.world_from_camera[:3, 3])

    def project(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Project world points (…, 3) to pixels and depths.

        Returns
        -------
        Columns and rows in pixels, and depths in metres, NaN behind the camera.
        """
        seen = (points - self.centre) @ self.world_from_camera[:3, :3]
        z = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        columns, rows = project(seen, self.camera)
        return columns, rows, z

    def compute_projection_to(self, other: PosedView) -> NDArray[np.float64]:
        """Return the projection (3, 4) from pixels with depth to another view.

        It maps (u z, v z, z, 1) to (u' z', v' z', z').
        """
        turn = other.world_from_camera[:3, :3].T
        into = other.camera.matrix @ turn
        rotation = into @ self.world_from_camera[:3, :3] @ np.linalg.inv(self.camera.matrix)
        return np.column_stack([rotation, into @ (self.centre - other.centre)])

    def contains(self, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask of image positions inside the image.

        Positions between the centres of the outermost pixels are inside; NaN is outside.
        """
        inside = (columns >= 0) & (columns <= self.camera.width - 1)
        return np.asarray(inside & (rows >= 0) & (rows <= self.camera.height - 1))


def create_posed_views(scan: Scan) -> list[PosedView]:
    """Create the views of a scan.

    Depth ranges are unknown yet, from 0 to infinity.

    Raises
    ------
    InputError
        If a frame has no valid pose, or no calibrated camera.
    """
    return [_create_view(frame, scan.folder) for frame in scan.frames]


def _create_view(frame: Frame, folder: Path | None) -> PosedView:
    pose, camera = frame.world_from_camera, frame.camera
    if pose is None or not np.isfinite(pose).all() or not camera.is_calibrated:
        lacking = "camera" if not camera.is_calibrated else "pose"
        raise InputError(
            POSE_MISSING,
            "frame {frame_name} has no {lacking}; depth from single views requires camera and pose.",
            folder,
            frame_name=frame.name,
            lacking=lacking,
        )
    if np.abs(pose).max() > _MAX_COORDINATE_M:
        raise InputError(
            POSE_INVALID,
            "the pose of frame {frame_name} is wrong: a coordinate is {max:g} m.",
            folder,
            frame_name=frame.name,
            max=np.abs(pose).max(),
        )
    return PosedView(to_pinhole(camera), np.asarray(pose, np.float64), 0.0, math.inf)
