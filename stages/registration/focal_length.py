"""Focal length estimation for cameras without stated intrinsics, from frames with depth.

A wrong focal length makes a depth map too wide or too narrow for its depth, so that two views do not fit.
Distances between matched points must be equal in both views. For each candidate focal length, frame pairs are
aligned; the candidate with the smallest residual wins.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.features import match_descriptors
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.registration.appearance import compute_similarity
from scanloom.stages.registration.codes import CAMERA_FOCAL_ESTIMATED
from scanloom.stages.registration.features import Features
from scanloom.stages.registration.static_background import find_static_matches
from scanloom.stages.registration.view import read_registration_view
from scanloom.stages.scans.codes import CAMERA_INTRINSICS_GUESSED
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Frame

Floats = NDArray[np.float64]

# Number of sampled frames, and maximum number of frame pairs (the most similar ones).
_SAMPLE_COUNT, _MAX_PAIRS = 20, 40
# Candidate focal lengths relative to the guess; then log offsets from the best candidate.
_CANDIDATE_FACTORS = np.exp(np.linspace(np.log(0.65), np.log(1.55), 15))
_LOG_OFFSETS = np.linspace(-0.12, 0.12, 13)
# Minimum number of matches and of inliers of a frame pair, and maximum number of inliers used; RANSAC trials.
_MIN_MATCHES, _MIN_INLIERS, _MAX_INLIERS = 20, 15, 80
_TRIALS = 200
# Maximum error of an inlier, pixels and relative depth; then typical errors in the same units; then the
# number of Gauss-Newton steps.
_INLIER_PX, _INLIER_DEPTH_RATIO = 4.0, 0.05
_TYPICAL_PX, _TYPICAL_DEPTH_RATIO = 1.0, 0.02
_STEPS = 8
# Minimum number of frame pairs, counted in both directions, maximum relative standard error, and number of
# groups for its estimation (jackknife).
_MIN_PAIRS, _MAX_ERROR_RATIO, _GROUPS = 10, 0.03, 8


@dataclass(frozen=True)
class FocalEstimate:
    """Estimated focal length.

    Attributes
    ----------
    guess_px, focal_px : guessed and estimated focal length of the depth camera, pixels.
    error_px : standard error from the spread between frame pairs; errors common to all pairs are not
        included.
    pair_count : number of frame pairs used.
    """

    guess_px: float
    focal_px: float
    error_px: float
    pair_count: int

    def to_dict(self) -> dict[str, Any]:
        """Return all fields as JSON values."""
        return {
            "guess_px": self.guess_px,
            "focal_px": self.focal_px,
            "error_px": self.error_px,
            "frame_pairs": self.pair_count,
        }

    def __str__(self) -> str:
        """Return the focal length with its error, as text."""
        return f"{self.focal_px:.1f} ± {self.error_px:.1f} px from {self.pair_count} frame pairs"

    def to_camera(self, guessed_camera: Camera) -> Camera:
        """Return the guessed camera with the estimated focal length."""
        return replace(guessed_camera, fx=self.focal_px, fy=self.focal_px, is_guess=False)


def report_focal_length(focal: FocalEstimate | None, guessed_camera: Camera) -> None:
    """Warn that the focal length is estimated, or still guessed (`focal` is None)."""
    if focal is None:
        emit(
            CAMERA_INTRINSICS_GUESSED.warning(
                "the focal length could not be estimated from the frames; the guess of {guess:g} px is used",
                remedy="set scan.intrinsics=fx,fy,cx,cy",
                guess=guessed_camera.fx,
            )
        )
        return
    emit(
        CAMERA_FOCAL_ESTIMATED.warning(
            "the focal length is estimated to be {focal} (guess: {guess:g} px); the principal point is "
            "assumed at the image centre.",
            remedy="If the intrinsics are known, set scan.intrinsics=fx,fy,cx,cy",
            focal=focal,
            guess=guessed_camera.fx,
        )
    )


@dataclass(frozen=True, eq=False)
class _MatchedPair:
    """Keypoint matches of a frame pair.

    Attributes
    ----------
    source_pixels, target_pixels : (n, 2) pixels in the first and in the second view, relative to the image
        centre.
    source_depth, target_depth : (n,) metres, in the first and in the second view.
    """

    source_pixels: Floats
    source_depth: Floats
    target_pixels: Floats
    target_depth: Floats

    def swap(self) -> _MatchedPair:
        return _MatchedPair(self.target_pixels, self.target_depth, self.source_pixels, self.source_depth)


@dataclass(frozen=True, eq=False)
class _PairPose:
    """Relative pose of a frame pair: rotation (3, 3), translation (3,), inlier mask (n,)."""

    rotation: Floats
    translation: Floats
    inliers: NDArray[np.bool_]


def has_guessed_camera(frames: Sequence[Frame]) -> bool:
    """Check whether all frames share one camera with guessed intrinsics."""
    cameras = {frame.camera for frame in frames}
    return (
        len(cameras) == 1
        and next(iter(cameras)).is_guess
        and all(frame.color_camera is None and frame.color is not None for frame in frames)
    )


def estimate_focal_length(frames: Sequence[Frame]) -> FocalEstimate | None:
    """Estimate the focal length from frames with a guessed camera.

    Returns None if too few frame pairs agree, or if the standard error is too large.
    """
    guessed = frames[0].camera
    couples, focal = _match_pairs(frames)
    if not couples:
        return None
    couples += [couple.swap() for couple in couples]
    placed = [
        [_estimate_pair_pose(couple, focal * factor) for couple in couples] for factor in _CANDIDATE_FACTORS
    ]
    scores = np.array([[score for score, _ in row] for row in placed]).sum(axis=1)
    best = int(np.argmax(scores))
    rows = [
        (couple, motion)
        for couple, (_, motion) in zip(couples, placed[best], strict=True)
        if motion is not None and np.count_nonzero(motion.inliers) >= _MIN_INLIERS
    ]
    if len(rows) < _MIN_PAIRS:
        return None
    logs = np.log(focal * _CANDIDATE_FACTORS[best]) + _LOG_OFFSETS
    problem = _PoseBatch(rows)
    costs = np.stack([problem.compute_costs(float(np.exp(log))) for log in logs])
    lowest = _interpolate_minimum(logs, costs.sum(axis=1))
    # Consecutive pairs share a jackknife group, because similar views are correlated.
    group = np.arange(len(rows)) * _GROUPS // len(rows)
    left_out = [_interpolate_minimum(logs, costs[:, group != one].sum(axis=1)) for one in range(_GROUPS)]
    if lowest is None or any(one is None for one in left_out):
        return None
    spread = np.array(left_out, np.float64)
    error = float(np.sqrt((_GROUPS - 1) / _GROUPS * ((spread - spread.mean()) ** 2).sum()))
    if error > _MAX_ERROR_RATIO:
        return None
    found = float(np.exp(lowest)) / focal * guessed.fx
    return FocalEstimate(guessed.fx, found, error * found, len(rows) // 2)


def _match_pairs(frames: Sequence[Frame]) -> tuple[list[_MatchedPair], float]:
    """Match the most similar pairs of sampled frames.

    Returns
    -------
    Matches of each pair, and the guessed focal length in pixels of the matched images.
    """

    def read_features(frame: Frame) -> Features | None:
        try:
            return read_registration_view(frame, np.inf).features
        except InputError:
            return None

    chosen = sample_evenly(len(frames), _SAMPLE_COUNT)
    threads = get_worker_count()
    read = map_ordered(read_features, [frames[n] for n in chosen], threads=threads, max_pending=threads)
    views = [one for one in read if one is not None and one.camera is not None]
    if len(views) < 2:
        return [], 0.0
    alike = compute_similarity(views)
    pairs = sorted(itertools.combinations(range(len(views)), 2), key=lambda pair: -alike[pair])
    found = []
    for a, b in pairs[: 2 * _MAX_PAIRS]:
        indices = match_descriptors(views[a].descriptors, views[b].descriptors)
        indices = indices[~find_static_matches(views[a], views[b], indices)]
        if len(indices) >= _MIN_MATCHES:
            found.append(_create_matched_pair(views[a], views[b], indices))
    found.sort(key=lambda couple: -len(couple.source_depth))
    camera = views[0].camera
    assert camera is not None
    return found[:_MAX_PAIRS], camera.fx


def _create_matched_pair(source: Features, target: Features, indices: NDArray[np.int64]) -> _MatchedPair:
    def select_side(view: Features, which: NDArray[np.int64]) -> tuple[Floats, Floats]:
        assert view.camera is not None
        centre = (view.camera.cx, view.camera.cy)
        return view.pixels[which].astype(np.float64) - centre, view.points[which, 2].astype(np.float64)

    return _MatchedPair(*select_side(source, indices[:, 0]), *select_side(target, indices[:, 1]))


def _unproject_pixels(pixels: Floats, depth: Floats, focal: float) -> Floats:
    return np.concatenate([pixels * (depth[..., None] / focal), depth[..., None]], axis=-1)


def _estimate_pair_pose(pair: _MatchedPair, focal: float) -> tuple[float, _PairPose | None]:
    """Estimate the relative pose of a frame pair for a focal length.

    Returns
    -------
    Score (sum of robust inlier weights) and relative pose; 0 and None if RANSAC fails.
    """
    import cv2

    points = _unproject_pixels(pair.source_pixels, pair.source_depth, focal)
    matrix = np.diag((focal, focal, 1.0))
    found, turn, shift, _ = cv2.solvePnPRansac(
        points,
        pair.target_pixels,
        matrix,
        None,
        iterationsCount=_TRIALS,
        reprojectionError=_INLIER_PX,
        confidence=0.99,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or not np.isfinite(turn).all():
        return 0.0, None
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    moved = points @ rotation.T + shift.ravel()
    z = np.where(moved[:, 2] > 0, moved[:, 2], np.inf)
    off = np.linalg.norm(moved[:, :2] / z[:, None] * focal - pair.target_pixels, axis=1) / _INLIER_PX
    deep = np.abs(moved[:, 2] - pair.target_depth) / pair.target_depth / _INLIER_DEPTH_RATIO
    weights = np.asarray((1 - off**2).clip(0) * (1 - deep**2).clip(0))
    return float(weights.sum()), _PairPose(rotation, np.asarray(shift, np.float64).ravel(), weights > 0)


class _PoseBatch:
    """Relative poses of frame pairs, fitted for any focal length in one batch."""

    def __init__(self, rows: Sequence[tuple[_MatchedPair, _PairPose]]) -> None:
        draw = np.random.default_rng(0)
        count = len(rows)
        self.pixels, self.there = np.zeros((count, _MAX_INLIERS, 2)), np.zeros((count, _MAX_INLIERS, 2))
        self.depth, self.depth_there = np.ones((count, _MAX_INLIERS)), np.ones((count, _MAX_INLIERS))
        self.used = np.zeros((count, _MAX_INLIERS))
        for k, (couple, motion) in enumerate(rows):
            chosen = draw.permutation(np.flatnonzero(motion.inliers))[:_MAX_INLIERS]
            n = len(chosen)
            self.pixels[k, :n], self.there[k, :n] = couple.source_pixels[chosen], couple.target_pixels[chosen]
            self.depth[k, :n], self.depth_there[k, :n] = (
                couple.source_depth[chosen],
                couple.target_depth[chosen],
            )
            self.used[k, :n] = 1
        self.turns = np.stack([motion.rotation for _, motion in rows])
        self.shifts = np.stack([motion.translation for _, motion in rows])

    def compute_costs(self, focal: float) -> Floats:
        """Compute the residual cost (n,) of each frame pair after fitting its pose.

        Gauss-Newton with Cauchy weights.
        """
        from scipy.spatial.transform import Rotation

        points = _unproject_pixels(self.pixels, self.depth, focal)
        turns, shifts = self.turns, self.shifts
        for _ in range(_STEPS):
            moved = np.einsum("pij,pmj->pmi", turns, points) + shifts[:, None]
            off, slopes = self._compute_residuals(moved, focal)
            weights = self.used / (1 + (off**2).sum(axis=-1))
            # A small rotation vector w moves a point p by w × p.
            x, y, z = moved[..., 0], moved[..., 1], moved[..., 2]
            o = np.zeros_like(x)
            cross = np.stack([o, z, -y, -z, o, x, y, -x, o], axis=-1).reshape(*x.shape, 3, 3)
            rows = np.concatenate([slopes @ cross, slopes], axis=-1)
            normal = np.einsum("pm,pmki,pmkj->pij", weights, rows, rows) + 1e-9 * np.eye(6)
            step = -np.linalg.solve(normal, np.einsum("pm,pmki,pmk->pi", weights, rows, off)[..., None])
            turn = Rotation.from_rotvec(step[:, :3, 0]).as_matrix()
            turns = turn @ turns
            shifts = np.einsum("pij,pj->pi", turn, shifts) + step[:, 3:, 0]
        moved = np.einsum("pij,pmj->pmi", turns, points) + shifts[:, None]
        off, _ = self._compute_residuals(moved, focal)
        return np.asarray((self.used * np.log1p((off**2).sum(axis=-1))).sum(axis=1))

    def _compute_residuals(self, moved: Floats, focal: float) -> tuple[Floats, Floats]:
        """Compute residuals of points (p, m, 3), and their derivatives by the point.

        Residuals are relative to the typical error.
        """
        x, y, z = moved[..., 0], moved[..., 1], np.maximum(moved[..., 2], 1e-3)
        deep = _TYPICAL_DEPTH_RATIO * self.depth_there
        across = np.stack([x, y], axis=-1) * (focal / z[..., None]) - self.there
        off = np.concatenate([across / _TYPICAL_PX, ((z - self.depth_there) / deep)[..., None]], axis=-1)
        slopes = np.zeros((*x.shape, 3, 3))
        slopes[..., 0, 0] = slopes[..., 1, 1] = focal / z / _TYPICAL_PX
        slopes[..., 0, 2] = -focal * x / z**2 / _TYPICAL_PX
        slopes[..., 1, 2] = -focal * y / z**2 / _TYPICAL_PX
        slopes[..., 2, 2] = 1 / deep
        # Scale of the Cauchy loss: twice the typical error.
        return off / 2, slopes / 2


def _interpolate_minimum(at: Floats, costs: Floats) -> float | None:
    """Interpolate the position of the minimum; None near the ends."""
    k = int(np.argmin(costs))
    if not 2 <= k <= len(at) - 3:
        return None
    curve = np.polyfit(at[k - 2 : k + 3] - at[k], costs[k - 2 : k + 3], 2)
    return float(at[k] - curve[1] / (2 * curve[0])) if curve[0] > 0 else None
