"""Check whether overlapping depth maps disagree systematically, depending on image position and range.

Pairs of frames are first aligned rigidly, because poses are less accurate than depth. Distances of their
surfaces are averaged over patches, which removes the noise. Then the smooth correction of `adjust` is fitted
(stages/adjusting/depth_calibration.py). It must explain the distances of pairs that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.agreement_check import find_usable_frames
from scanloom.stages.adjusting.depth_calibration import compute_depth_precision
from scanloom.stages.adjusting.final_depth_correction import may_fit_depth
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import PosedDepth, read_posed_depth
from scanloom.stages.frames.projection import project, unproject
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.fusion.fusion_plan import make_depth_limits
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.inspecting.codes import CAMERA_DEPTH_BENT
from scanloom.stages.scans.model.depth_correction import COEFFICIENT_COUNT, DepthCorrection
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, Frame, Pose

Floats = NDArray[np.float64]

# Number of pairs, candidates for the second frame, and minimum number of pairs with enough patches.
_PAIR_COUNT, _CANDIDATE_COUNT, _MIN_PAIR_COUNT = 16, 200, 8
# Grid of rays at median depth that finds pairs; minimum ratio of rays in both images; minimum mean shift
# between the images and largest useful one, in image sizes. Without a shift, both frames have the same error.
_RAY_GRID, _MIN_OVERLAP_RATIO, _MIN_SHIFT, _MAX_SHIFT = (8, 6), 0.35, 0.1, 0.35
# Points per image width for the alignment, and for the comparison.
_ALIGNMENT_STRIDES, _COMPARISON_STRIDES = 24, 107
_ALIGNMENT_STEPS = 2
# Points farther from the other surface than this ratio of their depth, or after the alignment than this many
# standard deviations, are on another surface.
_MAX_DISTANCE_RATIO, _MAX_SIGMAS = 0.05, 4.0
# Patches per image width, minimum points of a patch, and minimum patches of a pair. Averaging reduces the
# deviation at most to this part: neighbouring pixels of a sensor have common errors.
_PATCHES_PER_WIDTH, _MIN_PATCH_POINTS, _MIN_PATCHES, _MIN_AVERAGED_RATIO = 23, 4, 40, 0.25
# Prior of the rigid alignment: radians, metres.
_ROTATION_SIGMA, _TRANSLATION_SIGMA = 0.03, 0.05
# Tukey's biweight in standard deviations, and iterations.
_TUKEY_SIGMAS, _TUKEY_ITERATIONS = 3.0, 4
_FOLDS = 4
# Minimum decrease by the correction, on pairs it was not fitted to: of the mean squared distance, in standard
# errors over the pairs, and of the median distance. Measured: 42 % and 24 % for a Kinect (7-Scenes
# redkitchen), 50 % and 39 % for a made room with bent depth, at most 1 % and 2 % for made scans without. A
# table top at 0.5 m has 13 % and 9 %; there `adjust` finds no clear gain.
_MIN_GAIN_RATIO, _MIN_GAIN_SIGMAS, _MIN_MEDIAN_GAIN_RATIO = 0.2, 4.0, 0.12


def warn_bent_depth(frames: Sequence[Frame], noise: DepthNoise) -> None:
    """Warn if `adjust` would probably correct the depth of these frames.

    Parameters
    ----------
    frames : frames of a scan; those without colour, depth or pose are ignored.
    noise : depth noise, see `measure_depth_noise`.
    """
    found = measure_bent_depth(frames, noise)
    if found is not None and found.is_clear:
        emit(
            CAMERA_DEPTH_BENT.warning(
                "depth of overlapping frames differs by {share:.1%} of the distance, depending on the "
                "position in the image and the range",
                remedy="`scanloom run` and `scanloom adjust` estimate a correction, if the images allow it",
                share=found.difference_ratio,
            )
        )


@dataclass(frozen=True)
class BentDepth:
    """Systematic disagreement of overlapping depth maps.

    Attributes
    ----------
    gain_ratio : relative decrease of the mean squared distance by a smooth correction.
    gain_sigmas : this decrease in standard errors over the pairs.
    median_gain_ratio : relative decrease of the median distance.
    difference_ratio : RMS difference of the correction between both frames of a pair, relative to depth.
    """

    gain_ratio: float
    gain_sigmas: float
    median_gain_ratio: float
    difference_ratio: float

    @property
    def is_clear(self) -> bool:
        """Return True if a correction clearly improves the agreement."""
        return (
            self.gain_ratio > _MIN_GAIN_RATIO
            and self.gain_sigmas > _MIN_GAIN_SIGMAS
            and self.median_gain_ratio > _MIN_MEDIAN_GAIN_RATIO
        )


@dataclass(frozen=True, eq=False)
class _Comparison:
    """Distances between the surfaces of two aligned frames, averaged over k patches.

    Attributes
    ----------
    distances : (k,) along the normal, in standard deviations.
    by_motion : (k, 6) derivatives by a rotation vector and a translation of the first frame.
    by_bend : (k, d) derivatives by the coefficients of the correction.
    sigmas_m : (k,) standard deviations, metres.
    bases : (2, k, d) basis functions of the correction in both frames.
    """

    distances: Floats
    by_motion: Floats
    by_bend: Floats
    sigmas_m: Floats
    bases: Floats

    def scale_sigmas(self, factor: float) -> _Comparison:
        """Multiply the standard deviations by a factor."""
        return replace(
            self,
            distances=self.distances / factor,
            by_motion=self.by_motion / factor,
            by_bend=self.by_bend / factor,
            sigmas_m=self.sigmas_m * factor,
        )

    def align(self, coefficients: Floats) -> tuple[Floats, Floats]:
        """Align both frames for given coefficients.

        Returns
        -------
        Motion (6,) and the remaining distances (k,) in standard deviations.
        """
        return _align(self.distances + self.by_bend @ coefficients, self.by_motion)


def _align(distances: Floats, by_motion: Floats) -> tuple[Floats, Floats]:
    """Find the motion (6,) that minimises distances (k,); return it with the remaining distances.

    Parameters
    ----------
    by_motion : (k, 6) derivatives of the distances.
    """
    motion = np.zeros(6)
    for number in range(_TUKEY_ITERATIONS):
        scale = 1.0 if number else 2.0  # before the first alignment, distances are larger
        weighted = by_motion * _weight((distances + by_motion @ motion) / scale)[:, None]
        motion = -np.linalg.solve(
            by_motion.T @ weighted + np.diag(_get_motion_precision()), weighted.T @ distances
        )
    return motion, distances + by_motion @ motion


def measure_bent_depth(frames: Sequence[Frame], noise: DepthNoise) -> BentDepth | None:
    """Measure the systematic disagreement of overlapping depth maps.

    Parameters
    ----------
    frames : frames of a scan; those without colour, depth or pose are ignored.
    noise : depth noise, see `measure_depth_noise`.

    Returns
    -------
    None if there are too few overlapping frames, or if their depth maps have several cameras or a correction.
    """
    frames = [frames[i] for i in find_usable_frames(frames)]
    if len(frames) < 2 or noise == DepthNoise() or not may_fit_depth(frames, depth=True):
        return None
    views = _read_views(frames, [int(i) for i in sample_evenly(len(frames), _PAIR_COUNT)])
    sampled = [view.surface.depth[::16, ::16].ravel() for view in views.values()]
    depths = np.concatenate([np.zeros(0), *sampled])
    depths = depths[depths > 0]
    if not len(depths):
        return None
    pairs = _choose_pairs(frames, [*views], float(np.median(depths)))
    views |= _read_views(frames, sorted({second for _, second in pairs} - {*views}))
    near, far = (float(value) for value in np.percentile(depths, (2, 98)))
    camera = views[next(iter(views))].camera
    correction = DepthCorrection(camera.width, camera.height, near, far, (0.0,) * COEFFICIENT_COUNT)
    compare = partial(_compare, correction=correction, noise=noise)
    found = [
        compare(views[first], views[second]) for first, second in pairs if first in views and second in views
    ]
    comparisons = [one for one in found if one is not None]
    if len(comparisons) < _MIN_PAIR_COUNT:
        return None
    return _validate(_normalise(comparisons))


def _read_views(frames: Sequence[Frame], indices: Sequence[int]) -> dict[int, PosedDepth]:
    limits = make_depth_limits(FuseParams())

    def read(index: int) -> PosedDepth | None:
        try:
            return read_posed_depth(frames[index], limits)
        except InputError:
            return None

    threads = get_worker_count()
    read_views = zip(indices, map_ordered(read, indices, threads=threads, max_pending=threads), strict=True)
    return {index: view for index, view in read_views if view is not None}


def _choose_pairs(frames: Sequence[Frame], firsts: Sequence[int], depth: float) -> list[tuple[int, int]]:
    """Choose for each frame one that sees the same surface in another part of the image.

    Parameters
    ----------
    firsts : indices of the first frames.
    depth : typical depth, metres.
    """
    camera = frames[0].camera
    columns, rows = (
        ((np.arange(count) + 0.5) / count * size)
        for count, size in zip(_RAY_GRID, (camera.width, camera.height), strict=True)
    )
    grid = np.stack([axis.ravel() for axis in np.meshgrid(columns, rows)], axis=1)
    rays = unproject(grid[:, 0], grid[:, 1], np.full(len(grid), depth), camera)
    candidates = sample_evenly(len(frames), _CANDIDATE_COUNT)
    poses = np.array([frames[i].world_from_camera for i in candidates])
    pairs = []
    for first in firsts:
        pose = np.asarray(frames[first].world_from_camera)
        points = rays @ pose[:3, :3].T + pose[:3, 3]
        # Rows times rotation: coordinates in each candidate's camera axes.
        seen = np.einsum("mni,mij->mnj", points - poses[:, None, :3, 3], poses[:, :3, :3])
        with np.errstate(invalid="ignore"):
            pixels = np.stack(project(seen, camera), axis=-1)
            inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=-1)
        overlap = inside.mean(axis=1)
        moves = np.linalg.norm((pixels - grid) / (camera.width, camera.height), axis=-1)
        shift = np.where(inside, moves, 0).sum(axis=1) / np.maximum(inside.sum(axis=1), 1)
        is_useful = (overlap >= _MIN_OVERLAP_RATIO) & (shift >= _MIN_SHIFT)
        quality = np.where(is_useful, np.minimum(shift, _MAX_SHIFT) * np.sqrt(overlap), 0)
        if quality.any():
            pairs.append((first, int(candidates[quality.argmax()])))
    return pairs


def _compare(
    first: PosedDepth, second: PosedDepth, correction: DepthCorrection, noise: DepthNoise
) -> _Comparison | None:
    """Align two frames and compare their surfaces; None if they share too few patches."""
    second_from_first = invert_pose(second.pose) @ first.pose
    for _ in range(_ALIGNMENT_STEPS):
        points = _match_points(first, second, second_from_first, _ALIGNMENT_STRIDES)
        if len(points.depth) < _MIN_PATCHES:
            return None
        motion, _ = _align(*points.linearise_motion(noise))
        second_from_first = _make_motion(motion) @ second_from_first
    points = _match_points(first, second, second_from_first, _COMPARISON_STRIDES)
    side = max(first.camera.width // _PATCHES_PER_WIDTH, 1)
    patches = points.rows // side * (first.camera.width + 1) + points.columns // side
    averaged = _average(points.linearise(correction, noise), patches)
    return averaged if len(averaged.distances) >= _MIN_PATCHES else None


@dataclass(frozen=True, eq=False)
class _MatchedPoints:
    """Points of a first depth map, and the pixels of a second one that show them.

    Attributes
    ----------
    rows, columns, depth : (n,) pixel and depth in the first frame.
    rotated, points : (n, 3) points in axes of the second camera, relative to the first and the second one.
    second_rows, second_columns, second_depth : (n,) pixel and depth in the second frame.
    rays, normals : (n, 3) ray of that pixel with depth 1, and unit normal of the surface there.
    """

    rows: NDArray[np.intp]
    columns: NDArray[np.intp]
    depth: Floats
    rotated: Floats
    points: Floats
    second_rows: NDArray[np.intp]
    second_columns: NDArray[np.intp]
    second_depth: Floats
    rays: Floats
    normals: Floats

    @property
    def measured(self) -> Floats:
        """Points (n, 3) that the second frame measures, in axes of the second camera."""
        return self.rays * self.second_depth[:, None]

    def compute_sigmas(self, noise: DepthNoise) -> Floats:
        """Return the standard deviations (n,) of the distances between both surfaces, metres."""
        return np.asarray(np.sqrt(2) * (noise.constant + noise.quadratic * self.second_depth**2))

    def linearise_motion(self, noise: DepthNoise) -> tuple[Floats, Floats]:
        """Return the distances (n,) between both surfaces and their derivatives (n, 6) by motion.

        Both are in standard deviations.
        """
        sigmas = self.compute_sigmas(noise)
        by_motion = np.concatenate([np.cross(self.points, self.normals), self.normals], axis=1)
        distances = (self.normals * (self.points - self.measured)).sum(axis=1)
        return distances / sigmas, by_motion / sigmas[:, None]

    def linearise(self, correction: DepthCorrection, noise: DepthNoise) -> _Comparison:
        """Return the distances between both surfaces with their derivatives, one row per point."""
        sigmas = self.compute_sigmas(noise)
        distances, by_motion = self.linearise_motion(noise)
        pixels = (
            (self.columns, self.rows, self.depth),
            (self.second_columns, self.second_rows, self.second_depth),
        )
        bases = np.stack(
            [correction.compute_basis(*(axis.astype(np.float64) for axis in one)) for one in pixels]
        )
        along = [(self.normals * one).sum(axis=1) for one in (self.rotated, self.measured)]
        by_bend = along[0][:, None] * bases[0] - along[1][:, None] * bases[1]
        return _Comparison(distances, by_motion, by_bend / sigmas[:, None], sigmas, bases)


def _match_points(
    first: PosedDepth, second: PosedDepth, second_from_first: Pose, strides: int
) -> _MatchedPoints:
    """Match every n-th pixel of a depth map to the nearest pixel of another.

    Parameters
    ----------
    strides : number of points per image width.
    """
    camera: Camera = first.camera
    step = max(camera.width // strides, 1)
    rows, columns = np.nonzero(first.surface.depth[step // 2 :: step, step // 2 :: step])
    rows, columns = rows * step + step // 2, columns * step + step // 2
    depth = first.surface.depth[rows, columns].astype(np.float64)
    rotated = unproject(columns, rows, depth, camera) @ second_from_first[:3, :3].T
    points = rotated + second_from_first[:3, 3]
    with np.errstate(invalid="ignore"):
        at = np.stack(project(points, second.camera), axis=1).round()
        inside = ((at >= 0) & (at < (second.camera.width, second.camera.height))).all(axis=1)
    second_columns, second_rows = np.where(inside[:, None], at, 0).astype(np.intp).T
    second_depth = second.surface.depth[second_rows, second_columns].astype(np.float64)
    is_same = inside & (second_depth > 0)
    is_same &= np.abs(second_depth - points[:, 2]) < _MAX_DISTANCE_RATIO * points[:, 2]
    chosen = np.flatnonzero(is_same)
    second_rows, second_columns = second_rows[chosen], second_columns[chosen]
    normals = np.stack([axis[second_rows, second_columns] for axis in second.surface.normal], axis=1)
    obliqueness = second.surface.obliqueness[second_rows, second_columns]
    return _MatchedPoints(
        rows[chosen],
        columns[chosen],
        depth[chosen],
        rotated[chosen],
        points[chosen],
        second_rows,
        second_columns,
        second_depth[chosen],
        unproject(second_columns, second_rows, np.ones(len(chosen)), second.camera),
        (normals / obliqueness[:, None]).astype(np.float64),
    )


def _average(points: _Comparison, patches: NDArray[np.intp]) -> _Comparison:
    """Average the distances of points over patches; `patches` has the patch (n,) of each point."""
    is_near = np.abs(points.distances) < _MAX_SIGMAS
    numbers, labels, counts = np.unique(patches[is_near], return_inverse=True, return_counts=True)
    used = counts >= _MIN_PATCH_POINTS

    def average(values: Floats) -> Floats:
        """Average rows (n, c)."""
        sums = [np.bincount(labels, column, len(numbers)) for column in values[is_near].T]
        return np.asarray((np.stack(sums, axis=1) / counts[:, None])[used])

    metres = points.sigmas_m[:, None]
    sigmas = average(metres) * np.maximum(1 / np.sqrt(counts[used]), _MIN_AVERAGED_RATIO)[:, None]
    return _Comparison(
        (average(points.distances[:, None] * metres) / sigmas)[:, 0],
        average(points.by_motion * metres) / sigmas,
        average(points.by_bend * metres) / sigmas,
        sigmas[:, 0],
        np.stack([average(basis) for basis in points.bases]),
    )


def _normalise(comparisons: Sequence[_Comparison]) -> list[_Comparison]:
    """Scale standard deviations so that half of the distances are below 0.67 of them.

    Poses, shutter and the sensor itself leave errors that averaging does not reduce.
    """
    scaled = [*comparisons]
    none = np.zeros(COEFFICIENT_COUNT)
    for _ in range(3):
        distances = np.concatenate([np.abs(one.align(none)[1]) for one in scaled])
        factor = max(1.4826 * float(np.median(distances)), 0.3)
        scaled = [one.scale_sigmas(factor) for one in scaled]
    return scaled


def _validate(comparisons: Sequence[_Comparison]) -> BentDepth:
    """Fit the correction to most pairs and evaluate it on the others, in turns."""
    precision = compute_depth_precision(np.concatenate([one.bases[0] for one in comparisons]))
    none = np.zeros(COEFFICIENT_COUNT)
    gains, squares, distances = [], [], []
    for fold in range(_FOLDS):
        fitted = _fit([one for n, one in enumerate(comparisons) if n % _FOLDS != fold], precision)
        for one in comparisons[fold::_FOLDS]:
            remaining = np.abs(np.stack([one.align(coefficients)[1] for coefficients in (none, fitted)]))
            clipped = np.minimum(remaining, _TUKEY_SIGMAS) ** 2
            gains.append(float(clipped[0].mean() - clipped[1].mean()))
            squares.append(clipped)
            distances.append(remaining * one.sigmas_m)
    before, after = np.concatenate(squares, axis=1).mean(axis=1)
    medians = np.median(np.concatenate(distances, axis=1), axis=1)
    coefficients = _fit(comparisons, precision)
    differences = np.concatenate([(one.bases[0] - one.bases[1]) @ coefficients for one in comparisons])
    return BentDepth(
        gain_ratio=float(1 - after / before),
        gain_sigmas=float(np.mean(gains) / (np.std(gains, ddof=1) / np.sqrt(len(gains)) + 1e-12)),
        median_gain_ratio=float(1 - medians[1] / medians[0]),
        difference_ratio=float(np.sqrt((differences**2).mean())),
    )


def _fit(comparisons: Sequence[_Comparison], precision: Floats) -> Floats:
    """Fit the coefficients (d,) of the correction, with a separate motion for each pair."""
    coefficients = np.zeros(COEFFICIENT_COUNT)
    for _ in range(_TUKEY_ITERATIONS):
        matrix, vector = precision.copy(), np.zeros(COEFFICIENT_COUNT)
        for one in comparisons:
            weights = _weight(one.align(coefficients)[1])[:, None]
            # Schur complement of the motion.
            motion = np.linalg.inv(
                one.by_motion.T @ (weights * one.by_motion) + np.diag(_get_motion_precision())
            )
            coupling = one.by_bend.T @ (weights * one.by_motion) @ motion
            reduced = one.by_bend - one.by_motion @ coupling.T
            matrix += reduced.T @ (weights * one.by_bend)
            vector += reduced.T @ (weights[:, 0] * one.distances)
        coefficients = -np.linalg.solve(matrix, vector)
    return coefficients


def _weight(distances: Floats) -> Floats:
    """Return Tukey's biweight of distances in standard deviations."""
    return np.asarray(np.maximum(1 - (distances / _TUKEY_SIGMAS) ** 2, 0) ** 2)


def _get_motion_precision() -> Floats:
    return np.repeat([_ROTATION_SIGMA, _TRANSLATION_SIGMA], 3) ** -2.0


def _make_motion(motion: Floats) -> Pose:
    """Return the pose (4, 4) of a rotation vector and a translation (6,)."""
    import cv2

    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = cv2.Rodrigues(motion[:3])[0], motion[3:]
    return pose
