"""Keypoints with depth, and relative poses from their matches (SIFT; perspective-n-point)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import detect_keypoints, match_descriptors
from scanloom.stages.frames.projection import project, unproject
from scanloom.stages.registration.matched_points import MatchedPoints, fit_motion
from scanloom.stages.scans.model.scan import Camera, DepthImage, Pose

# Maximum image size for detection, pixels; number of keypoints detected, and kept (the strongest with depth).
# Then the grid over which keypoints are spread.
MAX_PIXELS = 640 * 480
_DETECTED_COUNT, _MAX_FEATURES = 2000, 800
_GRID_SHAPE = (8, 6)
# Contrast threshold of SIFT, lower than its default: smooth or blurred surfaces have no stronger keypoints.
_CONTRAST = 0.01
# Inlier thresholds: reprojection error in pixels, and error of the depth relative to the depth.
_INLIER_PX = 4.0
_INLIER_DEPTH_RATIO = 0.05
# Depth at a keypoint is fitted to neighbours within this many pixels whose depth differs by less than this
# ratio. The last value, in squared pixels, regularises the slope if there are few neighbours.
_NEIGHBOUR_RADIUS_PX, _MAX_DEPTH_DIFFERENCE_RATIO, _SLOPE_REGULARISATION = 3, 0.02, 4.0
# RANSAC trials for the first motion, and for further motions. The latter need fewer trials, because they are
# only accepted with a substantial ratio of the matches.
_TRIALS, _FURTHER_TRIALS = 1000, 300
# Maximum number of motions of a view pair, minimum number of inliers of a motion, and minimum ratio of
# inliers to the first motion.
_MAX_MOTIONS = 3
_MIN_INLIERS, _MIN_INLIER_RATIO = 8, 0.1


@dataclass(frozen=True, eq=False)
class Features:
    """Keypoints of a view that have depth.

    Attributes
    ----------
    pixels : (n, 2) float32.
    points : (n, 3) float32 metres, camera axes.
    descriptors : (n, 128) uint8 SIFT descriptors.
    camera : pinhole camera of the pixels; None without colour.
    """

    pixels: NDArray[np.float32]
    points: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    camera: Camera | None

    @classmethod
    def create_empty(cls) -> Features:
        """Create the empty features of a view without colour."""
        empty = np.zeros((0, 3), np.float32)
        return cls(empty[:, :2], empty, np.zeros((0, 128), np.uint8), None)


@dataclass(frozen=True, eq=False)
class FeatureMotion:
    """Relative pose of two views from matched keypoints.

    Attributes
    ----------
    target_from_source : (4, 4) metres.
    information : (6, 6) inverse covariance, see `inlier_count.fit_motion`.
    inlier_count : number of inliers, including held-out ones.
    held_out : inliers held out from the estimation.
    """

    target_from_source: Pose
    information: NDArray[np.float64]
    inlier_count: int
    held_out: MatchedPoints


def detect_features(grey: NDArray[np.uint8], camera: Camera, depth: DepthImage) -> Features:
    """Detect keypoints with depth.

    Parameters
    ----------
    grey : image from the position of the depth camera, any size.
    camera : camera of the grey image, without distortion.
    depth : metres, any size.
    """
    found = detect_keypoints(grey, _DETECTED_COUNT, contrast=_CONTRAST)
    pixels = found.pixels
    across, down = depth.shape[1] / grey.shape[1], depth.shape[0] / grey.shape[0]
    z = _interpolate_depth(depth, (pixels + 0.5) * (across, down) - 0.5)
    there = np.flatnonzero(z > 0)
    there = there[
        _order_by_cell(pixels[there] / (grey.shape[1], grey.shape[0]), found.strength[there])[:_MAX_FEATURES]
    ]
    pixels, z = pixels[there], z[there]
    columns, rows = pixels.T.astype(np.float64)
    points = unproject(columns, rows, z, camera).astype(np.float32)
    return Features(pixels, points, found.descriptors[there], camera)


def estimate_motions(source: Features, target: Features) -> list[FeatureMotion]:
    """Estimate the motions that matches agree on, most inliers first.

    The static scene and each object that moves independently have a separate motion. Motions with too few
    inliers are dropped.
    """
    if min(len(source.points), len(target.points)) < _MIN_INLIERS or target.camera is None:
        return []
    pairs = match_descriptors(source.descriptors, target.descriptors)
    found: list[FeatureMotion] = []
    least: float = _MIN_INLIERS
    while len(found) < _MAX_MOTIONS and len(pairs) >= least:
        points, there = source.points[pairs[:, 0]], target.points[pairs[:, 1]]
        pixels = target.pixels[pairs[:, 1]]
        pose = _estimate_pose_ransac(points, pixels, target.camera, _FURTHER_TRIALS if found else _TRIALS)
        if pose is None:
            break
        agree = _find_inliers(pose, points, there, pixels, target.camera, 1.0)
        count = int(np.count_nonzero(agree))
        if count < least:
            break
        focal = 0.5 * (target.camera.fx + target.camera.fy)
        matched, held = MatchedPoints(
            points[agree].astype(np.float64), there[agree].astype(np.float64), focal
        ).split_held_out()
        pose, information = fit_motion(matched, pose)
        found.append(FeatureMotion(pose, information, count, held))
        least = max(_MIN_INLIERS, _MIN_INLIER_RATIO * found[0].inlier_count)
        pairs = pairs[~(agree | _find_inliers(pose, points, there, pixels, target.camera, 2.0))]
    return found


def _interpolate_depth(depth: DepthImage, pixels: NDArray[np.floating]) -> NDArray[np.float32]:
    """Interpolate depth at subpixel positions (n, 2); 0 without depth.

    A plane is fitted to similar neighbours (inverse depth is linear in the image), which reduces the noise.
    """
    height, width = depth.shape
    columns, rows = np.rint(pixels).astype(int).T
    beside = np.arange(-_NEIGHBOUR_RADIUS_PX, _NEIGHBOUR_RADIUS_PX + 1)
    down, across = (one.ravel() for one in np.meshgrid(beside, beside, indexing="ij"))
    at_rows, at_columns = rows[:, None] + down, columns[:, None] + across
    values = depth[at_rows.clip(0, height - 1), at_columns.clip(0, width - 1)].astype(np.float64)
    there = depth[rows.clip(0, height - 1), columns.clip(0, width - 1)].astype(np.float64)[:, None]
    same = (values > 0) & (np.abs(values - there) <= _MAX_DEPTH_DIFFERENCE_RATIO * there)
    inverse = np.where(same, 1 / np.where(same, values, 1), 0)
    terms = np.ones((len(rows), len(down), 3))
    terms[:, :, 1] = at_columns - pixels[:, :1]
    terms[:, :, 2] = at_rows - pixels[:, 1:]
    known = terms * same[:, :, None]
    system = known.swapaxes(1, 2) @ known + np.diag([1e-9, _SLOPE_REGULARISATION, _SLOPE_REGULARISATION])
    fitted = np.linalg.solve(system, (known * inverse[:, :, None]).sum(axis=1)[:, :, None])[:, 0, 0]
    return np.where(there[:, 0] > 0, 1 / np.where(fitted > 0, fitted, 1), 0).astype(np.float32)


def _order_by_cell(positions: NDArray[np.floating], strength: NDArray[np.float32]) -> NDArray[np.int64]:
    """Order keypoints so that image cells take turns, strongest keypoints first.

    Otherwise a single textured object, which may move independently, could take all keypoints.

    Parameters
    ----------
    positions : (n, 2) positions in the image, 0 to 1.
    strength : (n,) detector response.
    """
    across, down = np.minimum((positions * _GRID_SHAPE).astype(int), np.array(_GRID_SHAPE) - 1).T
    cell = down * _GRID_SHAPE[0] + across
    order = np.lexsort((-strength, cell))
    first = np.flatnonzero(np.diff(cell[order], prepend=-1))
    turn = np.empty(len(order), np.int64)
    turn[order] = np.arange(len(order)) - np.repeat(first, np.diff(first, append=len(order)))
    return np.lexsort((-strength, turn))


def _estimate_pose_ransac(
    points: NDArray[np.float32], pixels: NDArray[np.float32], camera: Camera, trials: int
) -> Pose | None:
    """Estimate the pose with most inliers (RANSAC, perspective-three-point)."""
    import cv2

    found, rotation, shift, _ = cv2.solvePnPRansac(
        points.astype(np.float64),
        pixels.astype(np.float64),
        camera.matrix,
        None,
        iterationsCount=trials,
        reprojectionError=_INLIER_PX,
        confidence=0.999,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(rotation)[0], shift.ravel()
    return pose if np.isfinite(pose).all() else None


def _find_inliers(
    pose: Pose,
    points: NDArray[np.float32],
    target_points: NDArray[np.float32],
    pixels: NDArray[np.float32],
    camera: Camera,
    slack: float,
) -> NDArray[np.bool_]:
    """Check which points reproject to their matches, in pixels and in depth.

    `slack` multiplies the inlier thresholds.
    """
    moved = points @ pose[:3, :3].T + pose[:3, 3]
    columns, rows = project(moved, camera)
    near = np.hypot(columns - pixels[:, 0], rows - pixels[:, 1]) <= slack * _INLIER_PX
    return np.asarray(
        near
        & (np.abs(moved[:, 2] - target_points[:, 2]) <= slack * _INLIER_DEPTH_RATIO * target_points[:, 2]),
        bool,
    )
