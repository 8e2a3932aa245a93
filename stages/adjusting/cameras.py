"""Unknowns of the adjustment: poses of the views, and one correction of their common colour camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.lens import DISTORTION_COEFFICIENT_COUNT
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, scale_camera

# Number of unknowns of the colour camera: log of the focal length, principal point (x, y, pixels), k1, and
# extrinsics (x, y, z, metres, then a rotation vector, radians).
CAMERA_PARAMETER_COUNT = 10
# Number of unknowns of a pose: translation and rotation; with a rolling shutter also the rotation during
# readout. Then the maximum deviation of R Rᵀ from the identity, for poses read from text with few digits.
POSE_PARAMETER_COUNT, SHUTTER_POSE_PARAMETER_COUNT = 6, 9
_RIGID_TOLERANCE = 1e-2


@dataclass(frozen=True, eq=False)
class Cameras:
    """Depth and colour cameras of m views.

    Attributes
    ----------
    poses : (m, 4, 4) world_from_camera of the depth cameras.
    lenses : (m, 9) intrinsics of the colour cameras: fx, fy, cx, cy in pixels of the downscaled image
        (`View.size`), then the distortion coefficients k1, k2, p1, p2, k3.
    color_from_depth : (m, 4, 4) extrinsics of the colour cameras, metres.
    readout_rotations : (m, 3) rotation of each depth camera from its first to its last image row (rolling
        shutter).
        Rotation vectors in camera axes, radians. `pose_steps` refer to the middle row.
    """

    poses: NDArray[np.float64]
    lenses: NDArray[np.float64]
    color_from_depth: NDArray[np.float64]
    readout_rotations: NDArray[np.float64]

    @classmethod
    def from_frames(cls, frames: Sequence[Frame], lenses: Sequence[NDArray[np.float64]]) -> Cameras:
        """Create cameras from posed frames, as the scan gives them.

        Parameters
        ----------
        frames : m frames.
        lenses : m arrays (9,), see the attribute of the same name.
        """
        here = np.eye(4)
        return cls(
            np.stack([_orthonormalize_rotation(one.world_from_camera) for one in frames]),
            np.stack(lenses),
            np.stack([here if one.color_from_depth is None else one.color_from_depth for one in frames]),
            np.stack([np.zeros(3) if one.shutter_turn is None else one.shutter_turn for one in frames]),
        )

    def scale_focal_lengths(self, factor: float) -> Cameras:
        """Scale the focal lengths of the colour cameras."""
        lenses = self.lenses.copy()
        lenses[:, :2] *= factor
        return replace(self, lenses=lenses)

    def select(self, view_indices: NDArray[np.intp]) -> Cameras:
        """Select the cameras of some views."""
        return Cameras(
            self.poses[view_indices],
            self.lenses[view_indices],
            self.color_from_depth[view_indices],
            self.readout_rotations[view_indices],
        )

    def apply_step(self, pose_steps: NDArray[np.float64], camera_step: NDArray[np.float64]) -> Cameras:
        """Return the cameras after a step of the unknowns.

        Parameters
        ----------
        pose_steps : (m, 6) translation and rotation of each view in its own axes, metres and radians; (m, 9)
            also changes `readout_rotations`.
        camera_step : (10,) step of all colour cameras, see `CAMERA_PARAMETER_COUNT`.
        """
        lenses = self.lenses.copy()
        lenses[:, :2] *= np.exp(camera_step[0])
        lenses[:, 2:5] += camera_step[1:4]
        return Cameras(
            self.poses @ compute_motions(pose_steps[:, :POSE_PARAMETER_COUNT]),
            lenses,
            compute_motions(camera_step[None, 4:]) @ self.color_from_depth,
            self.readout_rotations + pose_steps[:, POSE_PARAMETER_COUNT:]
            if pose_steps.shape[1] == SHUTTER_POSE_PARAMETER_COUNT
            else self.readout_rotations,
        )


def is_rigid(pose: Pose | None) -> bool:
    """Check whether a pose exists, is finite and is nearly rigid."""
    if pose is None or not np.isfinite(pose).all():
        return False
    turn = np.asarray(pose, np.float64)[:3, :3]
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() < _RIGID_TOLERANCE and np.linalg.det(turn) > 0)


def _orthonormalize_rotation(pose: Pose | None) -> Pose:
    if pose is None:
        return np.eye(4)
    left, _, right = np.linalg.svd(pose[:3, :3])
    result = np.array(pose, np.float64)
    result[:3, :3] = left @ right
    return result


def compute_motions(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute motions (n, 4, 4) from translations and rotation vectors (n, 6).

    Rodrigues' formula; metres and radians.
    """
    turns = steps[:, 3:]
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    cross = compute_cross_matrices(turns)
    one = np.sinc(angle / np.pi)
    two = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    moves = np.tile(np.eye(4), (len(steps), 1, 1))
    moves[:, :3, :3] += one * cross + two * (cross @ cross)
    moves[:, :3, 3] = steps[:, :3]
    return moves


def decompose_motions(moves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Decompose motions (n, 4, 4) into translations and rotation vectors (n, 6).

    Inverse of `compute_motions`.
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()
    return np.concatenate([moves[:, :3, 3], turns], axis=1)


def compute_cross_matrices(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute cross-product matrices (n, 3, 3) of vectors (n, 3).

    `skew(a) @ b` is a × b.
    """
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def compute_camera_jacobian(
    points: NDArray[np.float64], by_point: NDArray[np.float64], by_lens: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the Jacobian of pixels with respect to the colour camera.

    Parameters
    ----------
    points : (n, 3) points in the axes of the colour camera, metres.
    by_point, by_lens : (n, 2, 3) and (n, 2, 4), see `lens.derivatives`.

    Returns
    -------
    (n, 2, 10) pixels per unit of each unknown, see `CAMERA_PARAMETER_COUNT`.
    """
    return np.concatenate([by_lens, by_point, -by_point @ compute_cross_matrices(points)], axis=2)


def invert_poses(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert rigid motions (n, 4, 4)."""
    back = np.tile(np.eye(4), (len(poses), 1, 1))
    back[:, :3, :3] = poses[:, :3, :3].swapaxes(1, 2)
    back[:, :3, 3] = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return back


def transform_points(motions: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform points (n, 3), each by its own motion (n, 4, 4)."""
    return np.asarray(np.einsum("nij,nj->ni", motions[:, :3, :3], points) + motions[:, :3, 3])


def get_lens_parameters(camera: Camera, width: int, height: int) -> NDArray[np.float64]:
    """Compute the lens parameters (9,) of a camera for an image size."""
    sized = scale_camera(camera, width, height)
    lens = np.zeros(4 + DISTORTION_COEFFICIENT_COUNT)
    lens[:4] = sized.fx, sized.fy, sized.cx, sized.cy
    lens[4 : 4 + len(camera.distortion)] = camera.distortion
    return lens


def create_camera(lens: NDArray[np.float64], size: tuple[int, int], full_size: tuple[int, int]) -> Camera:
    """Create a camera for images of full size from lens parameters.

    Parameters
    ----------
    lens : (9,), see `Cameras.lenses`.
    size : (width, height) that the lens parameters refer to.
    full_size : (width, height) of the images of the returned camera.
    """
    bent = tuple(float(k) for k in lens[4:])
    bent = bent if any(bent[4:]) else bent[:4]
    fx, fy, cx, cy = (float(value) for value in lens[:4])
    return scale_camera(Camera(*size, fx, fy, cx, cy, bent if any(bent) else ()), *full_size)


def compute_pose_distance(first: Pose, second: Pose) -> tuple[float, float]:
    """Compute the distance between two poses, in metres and degrees."""
    turn = (np.trace(first[:3, :3].T @ second[:3, :3]) - 1) / 2
    return float(np.linalg.norm(first[:3, 3] - second[:3, 3])), float(
        np.degrees(np.arccos(np.clip(turn, -1, 1)))
    )
