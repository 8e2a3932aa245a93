"""Unknowns of the adjustment: poses of the views, and one correction of their common colour camera."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.lens import OPENCV
from scanloom.stages.scans.model.scan import Camera, Frame, Pose, scaled

# Number of unknowns of the colour camera: log of the focal length, principal point (x, y, pixels), k1, and
# extrinsics (x, y, z, metres, then a rotation vector, radians).
FREE = 10
# Number of unknowns of a pose: translation and rotation; with a rolling shutter also the rotation during
# readout. Then the maximum deviation of R Rᵀ from the identity, for poses read from text with few digits.
STILL, TURNING = 6, 9
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
    turns : (m, 3) rotation of each depth camera from its first to its last image row (rolling shutter).
        Rotation vectors in camera axes, radians. `poses` refer to the middle row.
    """

    poses: NDArray[np.float64]
    lenses: NDArray[np.float64]
    color_from_depth: NDArray[np.float64]
    turns: NDArray[np.float64]

    @classmethod
    def given(cls, frames: Sequence[Frame], lenses: Sequence[NDArray[np.float64]]) -> Cameras:
        """Create cameras from posed frames, as the scan gives them.

        Parameters
        ----------
        frames : m frames.
        lenses : m arrays (9,), see the attribute of the same name.
        """
        here = np.eye(4)
        return cls(
            np.stack([_orthonormal(one.world_from_camera) for one in frames]),
            np.stack(lenses),
            np.stack([here if one.color_from_depth is None else one.color_from_depth for one in frames]),
            np.stack([np.zeros(3) if one.shutter_turn is None else one.shutter_turn for one in frames]),
        )

    def zoomed(self, share: float) -> Cameras:
        """Scale the focal lengths of the colour cameras."""
        lenses = self.lenses.copy()
        lenses[:, :2] *= share
        return replace(self, lenses=lenses)

    def of(self, which: NDArray[np.intp]) -> Cameras:
        """Select the cameras of some views."""
        return Cameras(self.poses[which], self.lenses[which], self.color_from_depth[which], self.turns[which])

    def moved(self, poses: NDArray[np.float64], camera: NDArray[np.float64]) -> Cameras:
        """Return the cameras after a step of the unknowns.

        Parameters
        ----------
        poses : (m, 6) translation and rotation of each view in its own axes, metres and radians; (m, 9) also
            changes `turns`.
        camera : (10,) step of all colour cameras, see `FREE`.
        """
        lenses = self.lenses.copy()
        lenses[:, :2] *= np.exp(camera[0])
        lenses[:, 2:5] += camera[1:4]
        return Cameras(
            self.poses @ motion(poses[:, :STILL]),
            lenses,
            motion(camera[None, 4:]) @ self.color_from_depth,
            self.turns + poses[:, STILL:] if poses.shape[1] == TURNING else self.turns,
        )


def is_rigid(pose: Pose | None) -> bool:
    """Check whether a pose exists, is finite and is nearly rigid."""
    if pose is None or not np.isfinite(pose).all():
        return False
    turn = np.asarray(pose, np.float64)[:3, :3]
    return bool(np.abs(turn @ turn.T - np.eye(3)).max() < _RIGID_TOLERANCE and np.linalg.det(turn) > 0)


def _orthonormal(pose: Pose | None) -> Pose:
    if pose is None:
        return np.eye(4)
    left, _, right = np.linalg.svd(pose[:3, :3])
    result = np.array(pose, np.float64)
    result[:3, :3] = left @ right
    return result


def motion(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute motions (n, 4, 4) from translations and rotation vectors (n, 6).

    Rodrigues' formula; metres and radians.
    """
    turns = steps[:, 3:]
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    cross = skew(turns)
    one = np.sinc(angle / np.pi)
    two = 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    moves = np.tile(np.eye(4), (len(steps), 1, 1))
    moves[:, :3, :3] += one * cross + two * (cross @ cross)
    moves[:, :3, 3] = steps[:, :3]
    return moves


def steps_of(moves: NDArray[np.float64]) -> NDArray[np.float64]:
    """Decompose motions (n, 4, 4) into translations and rotation vectors (n, 6).

    Inverse of `motion`.
    """
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_matrix(moves[:, :3, :3]).as_rotvec()
    return np.concatenate([moves[:, :3, 3], turns], axis=1)


def skew(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute cross-product matrices (n, 3, 3) of vectors (n, 3).

    `skew(a) @ b` is a × b.
    """
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=-1).reshape(-1, 3, 3)


def by_camera(
    shown: NDArray[np.float64], by_point: NDArray[np.float64], by_lens: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the Jacobian of pixels with respect to the colour camera.

    Parameters
    ----------
    shown : (n, 3) points in the axes of the colour camera, metres.
    by_point, by_lens : (n, 2, 3) and (n, 2, 4), see `lens.derivatives`.

    Returns
    -------
    (n, 2, 10) pixels per unit of each unknown, see `FREE`.
    """
    return np.concatenate([by_lens, by_point, -by_point @ skew(shown)], axis=2)


def inverted_all(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert rigid motions (n, 4, 4)."""
    back = np.tile(np.eye(4), (len(poses), 1, 1))
    back[:, :3, :3] = poses[:, :3, :3].swapaxes(1, 2)
    back[:, :3, 3] = -np.einsum("nji,nj->ni", poses[:, :3, :3], poses[:, :3, 3])
    return back


def carried(moves: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Transform points (n, 3), each by its own motion (n, 4, 4)."""
    return np.asarray(np.einsum("nij,nj->ni", moves[:, :3, :3], points) + moves[:, :3, 3])


def lens_of(camera: Camera, width: int, height: int) -> NDArray[np.float64]:
    """Compute the lens parameters (9,) of a camera for an image size."""
    sized = scaled(camera, width, height)
    lens = np.zeros(4 + OPENCV)
    lens[:4] = sized.fx, sized.fy, sized.cx, sized.cy
    lens[4 : 4 + len(camera.distortion)] = camera.distortion
    return lens


def camera_of(lens: NDArray[np.float64], size: tuple[int, int], full_size: tuple[int, int]) -> Camera:
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
    return scaled(Camera(*size, fx, fy, cx, cy, bent if any(bent) else ()), *full_size)


def motion_apart(one: Pose, other: Pose) -> tuple[float, float]:
    """Compute the distance between two poses, in metres and degrees."""
    turn = (np.trace(one[:3, :3].T @ other[:3, :3]) - 1) / 2
    return float(np.linalg.norm(one[:3, 3] - other[:3, 3])), float(
        np.degrees(np.arccos(np.clip(turn, -1, 1)))
    )
