"""Points with depth that are recognised from view to view, and the motion they tell (perspective-n-point)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.scan import Camera, DepthImage, Pose
from stages.sift import keypoints, matches

# Of each view, the strongest.
_MOST = 800
# Pixels that a point may be off where the other view sees it, and the share of its depth along it.
_OFF_PX = 3.0
_OFF_DEPTH = 0.05
_TRIALS = 2000


@dataclass(frozen=True, eq=False)
class Features:
    """Recognisable points of a view that have a depth.

    Attributes
    ----------
    pixels : (n, 2) float32, of the full depth image.
    points : (n, 3) float32, metres, camera axes.
    descriptors : (n, 128) float32 of unit length (RootSIFT).
    camera : the camera of the pixels.
    """

    pixels: NDArray[np.float32]
    points: NDArray[np.float32]
    descriptors: NDArray[np.float32]
    camera: Camera | None

    @classmethod
    def none(cls) -> Features:
        """Return the features of a view without colour."""
        empty = np.zeros((0, 3), np.float32)
        return cls(empty[:, :2], empty, np.zeros((0, 128), np.float32), None)


@dataclass(frozen=True, eq=False)
class Recognised:
    """How a view is placed to another by what both show.

    Attributes
    ----------
    target_from_source : (4, 4) metres.
    points : matched points that agree with it.
    """

    target_from_source: Pose
    points: int


def features_of(grey: NDArray[np.uint8], depth: DepthImage, camera: Camera) -> Features:
    """Return the features of an image in the geometry of its depth map."""
    found = keypoints(grey, _MOST)
    columns, rows = np.rint(found.pixels).astype(int).T
    z = depth[rows.clip(0, depth.shape[0] - 1), columns.clip(0, depth.shape[1] - 1)]
    there = z > 0
    pixels, z = found.pixels[there], z[there]
    rays = (pixels - (camera.cx, camera.cy)) / (camera.fx, camera.fy)
    points = np.column_stack([rays * z[:, None], z]).astype(np.float32)
    return Features(pixels, points, found.descriptors[there], camera)


def recognise(source: Features, target: Features) -> Recognised | None:
    """Return the motion that most matches agree on, or None if too few points can be matched."""
    import cv2

    if len(source.points) < 8 or len(target.points) < 8 or target.camera is None:
        return None
    pairs = matches(source.descriptors, target.descriptors)
    if len(pairs) < 8:
        return None
    points, pixels = source.points[pairs[:, 0]], target.pixels[pairs[:, 1]]
    found, rotation, shift, inliers = cv2.solvePnPRansac(
        points.astype(np.float64),
        pixels.astype(np.float64),
        target.camera.matrix,
        None,
        iterationsCount=_TRIALS,
        reprojectionError=_OFF_PX,
        confidence=0.999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or inliers is None or len(inliers) < 8:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation)[0], shift.ravel()
    if not np.isfinite(pose).all():
        return None
    chosen = inliers.ravel()
    moved = points[chosen] @ pose[:3, :3].T + pose[:3, 3]
    there = target.points[pairs[chosen, 1]]
    agree = np.abs(moved[:, 2] - there[:, 2]) <= _OFF_DEPTH * there[:, 2]
    if np.count_nonzero(agree) < 8:
        return None
    return Recognised(_fitted(points[chosen][agree], there[agree], pose), int(np.count_nonzero(agree)))


def _fitted(source: NDArray[np.float32], target: NDArray[np.float32], near: Pose) -> Pose:
    """Return the rigid motion of least squared error (Kabsch), or `near` where points do not fix one."""
    weights = 1.0 / target[:, 2].astype(np.float64) ** 2
    weights /= weights.sum()
    a, b = source.astype(np.float64), target.astype(np.float64)
    centre_a, centre_b = weights @ a, weights @ b
    u, size, vt = np.linalg.svd((weights[:, None] * (a - centre_a)).T @ (b - centre_b))
    if size[1] < 1e-9 * max(size[0], 1e-300):
        return near
    mirror = np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))])
    pose = np.eye(4)
    pose[:3, :3] = vt.T @ mirror @ u.T
    pose[:3, 3] = centre_b - pose[:3, :3] @ centre_a
    return pose
