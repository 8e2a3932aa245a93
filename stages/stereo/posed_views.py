"""Single views with poses, and the range of depth in which each of them sees the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.projection import project, unproject
from scanloom.stages.scans.codes import POSE_INVALID, POSE_MISSING
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, Scan, pinhole

# No scan is that far from its origin.
_FARTHEST_M = 1e9


@dataclass(frozen=True, eq=False)
class PosedView:
    """A view without distortion, and where to look for depth in it.

    Attributes
    ----------
    camera : of the undistorted image.
    world_from_camera : (4, 4) float64, metres.
    near, far : metres along the optical axis.
    """

    camera: Camera
    world_from_camera: Pose
    near: float
    far: float

    @property
    def centre(self) -> NDArray[np.float64]:
        """Return where the camera stands, (3,) metres."""
        return np.asarray(self.world_from_camera[:3, 3])

    @property
    def middle(self) -> float:
        """Return the geometric mean of the range of depth, metres."""
        return math.sqrt(self.near * self.far)

    def rays(self, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the rays (…, 3) through pixels, in camera axes, of z = 1."""
        return unproject(columns, rows, 1, self.camera)

    def spread_rays(self, count: int) -> NDArray[np.float64]:
        """Return rays (count², 3) evenly spread over the image, the corners' among them."""
        columns, rows = np.meshgrid(
            np.linspace(-0.5, self.camera.width - 0.5, count),
            np.linspace(-0.5, self.camera.height - 0.5, count),
        )
        return self.rays(columns.ravel(), rows.ravel())

    def to_world(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return points (…, 3) of camera axes in the world."""
        return np.asarray(points @ self.world_from_camera[:3, :3].T + self.world_from_camera[:3, 3])

    def project(
        self, points: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return columns, rows (pixels) and depths (metres) of world points (…, 3); NaN for those behind."""
        seen = (points - self.centre) @ self.world_from_camera[:3, :3]
        z = np.where(seen[..., 2] > 0, seen[..., 2], np.nan)
        columns, rows = project(seen, self.camera)
        return columns, rows, z

    def pixels_to(self, other: PosedView) -> NDArray[np.float64]:
        """Return the (3, 4) matrix from (u z, v z, z, 1) to (u' z', v' z', z') of another view."""
        turn = other.world_from_camera[:3, :3].T
        into = other.camera.matrix @ turn
        rotation = into @ self.world_from_camera[:3, :3] @ np.linalg.inv(self.camera.matrix)
        return np.column_stack([rotation, into @ (self.centre - other.centre)])

    def holds(self, columns: NDArray[np.float64], rows: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return which positions lie between the centres of the image's outermost pixels; NaN does not."""
        inside = (columns >= 0) & (columns <= self.camera.width - 1)
        return np.asarray(inside & (rows >= 0) & (rows <= self.camera.height - 1))


def posed_views(scan: Scan) -> list[PosedView]:
    """Return the views of a scan, their range of depth still open: from 0 to infinity.

    Raises
    ------
    InputError
        If a frame has no pose, or no calibrated camera.
    """
    return [_view(frame, scan.folder) for frame in scan.frames]


def _view(frame: Frame, folder: Path | None) -> PosedView:
    pose, camera = frame.world_from_camera, frame.camera
    if pose is None or not np.isfinite(pose).all() or not camera.is_calibrated:
        lacking = "camera" if not camera.is_calibrated else "pose"
        raise InputError(
            POSE_MISSING,
            "frame {frame_name} has no {lacking}; views need both.",
            folder,
            frame_name=frame.name,
            lacking=lacking,
        )
    if np.abs(pose).max() > _FARTHEST_M:
        raise InputError(
            POSE_INVALID,
            "frame {frame_name} stands {max:g} m off; its pose is wrong.",
            folder,
            frame_name=frame.name,
            max=np.abs(pose).max(),
        )
    return PosedView(pinhole(camera), np.asarray(pose, np.float64), 0.0, math.inf)
