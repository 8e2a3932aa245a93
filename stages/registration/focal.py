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
from scanloom.stages.registration.appearance import likeness
from scanloom.stages.registration.codes import CAMERA_FOCAL_ESTIMATED
from scanloom.stages.registration.features import Features
from scanloom.stages.registration.still import is_still
from scanloom.stages.registration.view import read_view
from scanloom.stages.scans.codes import CAMERA_INTRINSICS_GUESSED
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, Frame

Floats = NDArray[np.float64]

# Number of sampled frames, and maximum number of frame pairs (the most similar ones).
_FRAMES, _COUPLES = 20, 40
# Candidate focal lengths relative to the guess; then log offsets from the best candidate.
_TRIED = np.exp(np.linspace(np.log(0.65), np.log(1.55), 15))
_CLOSE = np.linspace(-0.12, 0.12, 13)
# Minimum number of matches and of inliers of a frame pair, and maximum number of inliers used; RANSAC trials.
_MATCHES, _AGREE, _USED = 20, 15, 80
_TRIALS = 200
# Maximum error of an inlier, pixels and relative depth; then typical errors in the same units; then the
# number of Gauss-Newton steps.
_OFF_PX, _OFF_DEPTH = 4.0, 0.05
_USUAL_PX, _USUAL_DEPTH = 1.0, 0.02
_STEPS = 8
# Minimum number of frame pairs, counted in both directions, maximum relative standard error, and number of
# groups for its estimation (jackknife).
_LEAST_COUPLES, _MOST_ERROR, _GROUPS = 10, 0.03, 8


@dataclass(frozen=True)
class Focal:
    """Estimated focal length.

    Attributes
    ----------
    guess_px, focal_px : guessed and estimated focal length of the depth camera, pixels.
    error_px : standard error from the spread between frame pairs; errors common to all pairs are not
        included.
    couples : number of frame pairs used.
    """

    guess_px: float
    focal_px: float
    error_px: float
    couples: int

    def figures(self) -> dict[str, Any]:
        """Return all fields as JSON values."""
        return {
            "guess_px": self.guess_px,
            "focal_px": self.focal_px,
            "error_px": self.error_px,
            "couples": self.couples,
        }

    def __str__(self) -> str:
        """Return the focal length with its error, as text."""
        return f"{self.focal_px:.1f} ± {self.error_px:.1f} px from {self.couples} frame pairs"

    def camera(self, guessed: Camera) -> Camera:
        """Return the guessed camera with the estimated focal length."""
        return replace(guessed, fx=self.focal_px, fy=self.focal_px, is_guess=False)


def report_focal(focal: Focal | None, guess: Camera) -> None:
    """Warn that the focal length is estimated, or still guessed (`focal` is None)."""
    if focal is None:
        emit(
            CAMERA_INTRINSICS_GUESSED.warning(
                "the focal length could not be estimated from the frames; the guess of {guess:g} px is used",
                remedy="set scan.intrinsics=fx,fy,cx,cy",
                guess=guess.fx,
            )
        )
        return
    emit(
        CAMERA_FOCAL_ESTIMATED.warning(
            "the focal length is estimated to be {focal} (guess: {guess:g} px); the principal point is "
            "assumed at the image centre.",
            remedy="If the intrinsics are known, set scan.intrinsics=fx,fy,cx,cy",
            focal=focal,
            guess=guess.fx,
        )
    )


@dataclass(frozen=True, eq=False)
class _Couple:
    """Keypoint matches of a frame pair.

    Attributes
    ----------
    pixels, there : (n, 2) pixels in the first and in the second view, relative to the image centre.
    depth, depth_there : (n,) metres, in the first and in the second view.
    """

    pixels: Floats
    depth: Floats
    there: Floats
    depth_there: Floats

    def turned_round(self) -> _Couple:
        return _Couple(self.there, self.depth_there, self.pixels, self.depth)


@dataclass(frozen=True, eq=False)
class _Placed:
    """Relative pose of a frame pair: rotation (3, 3), translation (3,), inlier mask (n,)."""

    turn: Floats
    shift: Floats
    agree: NDArray[np.bool_]


def is_guess(frames: Sequence[Frame]) -> bool:
    """Check whether all frames share one camera with guessed intrinsics."""
    cameras = {frame.camera for frame in frames}
    return (
        len(cameras) == 1
        and next(iter(cameras)).is_guess
        and all(frame.color_camera is None and frame.color is not None for frame in frames)
    )


def focal_of(frames: Sequence[Frame]) -> Focal | None:
    """Estimate the focal length from frames with a guessed camera.

    Returns None if too few frame pairs agree, or if the standard error is too large.
    """
    guessed = frames[0].camera
    couples, focal = _couples(frames)
    if not couples:
        return None
    couples += [couple.turned_round() for couple in couples]
    placed = [[_placed(couple, focal * factor) for couple in couples] for factor in _TRIED]
    scores = np.array([[score for score, _ in row] for row in placed]).sum(axis=1)
    best = int(np.argmax(scores))
    rows = [
        (couple, motion)
        for couple, (_, motion) in zip(couples, placed[best], strict=True)
        if motion is not None and np.count_nonzero(motion.agree) >= _AGREE
    ]
    if len(rows) < _LEAST_COUPLES:
        return None
    logs = np.log(focal * _TRIED[best]) + _CLOSE
    problem = _Problem(rows)
    costs = np.stack([problem.costs(float(np.exp(log))) for log in logs])
    lowest = _lowest(logs, costs.sum(axis=1))
    # Consecutive pairs share a jackknife group, because similar views are correlated.
    group = np.arange(len(rows)) * _GROUPS // len(rows)
    left_out = [_lowest(logs, costs[:, group != one].sum(axis=1)) for one in range(_GROUPS)]
    if lowest is None or any(one is None for one in left_out):
        return None
    spread = np.array(left_out, np.float64)
    error = float(np.sqrt((_GROUPS - 1) / _GROUPS * ((spread - spread.mean()) ** 2).sum()))
    if error > _MOST_ERROR:
        return None
    found = float(np.exp(lowest)) / focal * guessed.fx
    return Focal(guessed.fx, found, error * found, len(rows) // 2)


def _couples(frames: Sequence[Frame]) -> tuple[list[_Couple], float]:
    """Match the most similar pairs of sampled frames.

    Returns
    -------
    Matches of each pair, and the guessed focal length in pixels of the matched images.
    """

    def features(frame: Frame) -> Features | None:
        try:
            return read_view(frame, np.inf).features
        except InputError:
            return None

    chosen = sample_evenly(len(frames), _FRAMES)
    threads = workers()
    read = read_ahead(features, [frames[n] for n in chosen], threads=threads, ahead=threads)
    views = [one for one in read if one is not None and one.camera is not None]
    if len(views) < 2:
        return [], 0.0
    alike = likeness(views)
    pairs = sorted(itertools.combinations(range(len(views)), 2), key=lambda pair: -alike[pair])
    found = []
    for a, b in pairs[: 2 * _COUPLES]:
        indices = match_descriptors(views[a].descriptors, views[b].descriptors)
        indices = indices[~is_still(views[a], views[b], indices)]
        if len(indices) >= _MATCHES:
            found.append(_couple(views[a], views[b], indices))
    found.sort(key=lambda couple: -len(couple.depth))
    camera = views[0].camera
    assert camera is not None
    return found[:_COUPLES], camera.fx


def _couple(source: Features, target: Features, indices: NDArray[np.int64]) -> _Couple:
    def half(view: Features, which: NDArray[np.int64]) -> tuple[Floats, Floats]:
        assert view.camera is not None
        centre = (view.camera.cx, view.camera.cy)
        return view.pixels[which].astype(np.float64) - centre, view.points[which, 2].astype(np.float64)

    return _Couple(*half(source, indices[:, 0]), *half(target, indices[:, 1]))


def _points(pixels: Floats, depth: Floats, focal: float) -> Floats:
    return np.concatenate([pixels * (depth[..., None] / focal), depth[..., None]], axis=-1)


def _placed(couple: _Couple, focal: float) -> tuple[float, _Placed | None]:
    """Estimate the relative pose of a frame pair for a focal length.

    Returns
    -------
    Score (sum of robust inlier weights) and relative pose; 0 and None if RANSAC fails.
    """
    import cv2

    points = _points(couple.pixels, couple.depth, focal)
    matrix = np.diag((focal, focal, 1.0))
    found, turn, shift, _ = cv2.solvePnPRansac(
        points,
        couple.there,
        matrix,
        None,
        iterationsCount=_TRIALS,
        reprojectionError=_OFF_PX,
        confidence=0.99,
        flags=cv2.SOLVEPNP_AP3P,
    )
    if not found or not np.isfinite(turn).all():
        return 0.0, None
    rotation = np.asarray(cv2.Rodrigues(turn)[0], np.float64)
    moved = points @ rotation.T + shift.ravel()
    z = np.where(moved[:, 2] > 0, moved[:, 2], np.inf)
    off = np.linalg.norm(moved[:, :2] / z[:, None] * focal - couple.there, axis=1) / _OFF_PX
    deep = np.abs(moved[:, 2] - couple.depth_there) / couple.depth_there / _OFF_DEPTH
    weights = np.asarray((1 - off**2).clip(0) * (1 - deep**2).clip(0))
    return float(weights.sum()), _Placed(rotation, np.asarray(shift, np.float64).ravel(), weights > 0)


class _Problem:
    """Relative poses of frame pairs, fitted for any focal length in one batch."""

    def __init__(self, rows: Sequence[tuple[_Couple, _Placed]]) -> None:
        draw = np.random.default_rng(0)
        count = len(rows)
        self.pixels, self.there = np.zeros((count, _USED, 2)), np.zeros((count, _USED, 2))
        self.depth, self.depth_there = np.ones((count, _USED)), np.ones((count, _USED))
        self.used = np.zeros((count, _USED))
        for k, (couple, motion) in enumerate(rows):
            chosen = draw.permutation(np.flatnonzero(motion.agree))[:_USED]
            n = len(chosen)
            self.pixels[k, :n], self.there[k, :n] = couple.pixels[chosen], couple.there[chosen]
            self.depth[k, :n], self.depth_there[k, :n] = couple.depth[chosen], couple.depth_there[chosen]
            self.used[k, :n] = 1
        self.turns = np.stack([motion.turn for _, motion in rows])
        self.shifts = np.stack([motion.shift for _, motion in rows])

    def costs(self, focal: float) -> Floats:
        """Compute the residual cost (n,) of each frame pair after fitting its pose.

        Gauss-Newton with Cauchy weights.
        """
        from scipy.spatial.transform import Rotation

        points = _points(self.pixels, self.depth, focal)
        turns, shifts = self.turns, self.shifts
        for _ in range(_STEPS):
            moved = np.einsum("pij,pmj->pmi", turns, points) + shifts[:, None]
            off, slopes = self._off(moved, focal)
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
        off, _ = self._off(moved, focal)
        return np.asarray((self.used * np.log1p((off**2).sum(axis=-1))).sum(axis=1))

    def _off(self, moved: Floats, focal: float) -> tuple[Floats, Floats]:
        """Compute residuals of points (p, m, 3), and their derivatives by the point.

        Residuals are relative to the typical error.
        """
        x, y, z = moved[..., 0], moved[..., 1], np.maximum(moved[..., 2], 1e-3)
        deep = _USUAL_DEPTH * self.depth_there
        across = np.stack([x, y], axis=-1) * (focal / z[..., None]) - self.there
        off = np.concatenate([across / _USUAL_PX, ((z - self.depth_there) / deep)[..., None]], axis=-1)
        slopes = np.zeros((*x.shape, 3, 3))
        slopes[..., 0, 0] = slopes[..., 1, 1] = focal / z / _USUAL_PX
        slopes[..., 0, 2] = -focal * x / z**2 / _USUAL_PX
        slopes[..., 1, 2] = -focal * y / z**2 / _USUAL_PX
        slopes[..., 2, 2] = 1 / deep
        # Scale of the Cauchy loss: twice the typical error.
        return off / 2, slopes / 2


def _lowest(at: Floats, costs: Floats) -> float | None:
    """Interpolate the position of the minimum; None near the ends."""
    k = int(np.argmin(costs))
    if not 2 <= k <= len(at) - 3:
        return None
    curve = np.polyfit(at[k - 2 : k + 3] - at[k], costs[k - 2 : k + 3], 2)
    return float(at[k] - curve[1] / (2 * curve[0])) if curve[0] > 0 else None
