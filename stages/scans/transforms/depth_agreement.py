"""Scale and offset of predicted depth maps, from the agreement of the views.

A network predicts the depth of each view with a slightly different scale and offset. The depth z of view i
becomes a_i z + b_i. A point of one view, seen from another one, must have the depth that the other view
predicts there. The numbers of all views are found together by iteratively reweighted least squares
(Gauss-Newton). The poses fix the common scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.scans.codes import SCAN_DEPTH_ALIGNED
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Frame, PackedImage, Pose

# Grid of samples per view: columns and rows.
_GRID = (32, 24)
# Views that each view is compared with, and the minimum ratio of its samples they must see.
_MAX_PARTNERS = 8
_MIN_SEEN_RATIO = 0.1
_PARTNER_SAMPLES = 48
_ITERATIONS = 8
# Relative difference of depth above which two views see different surfaces, in the first and last iteration.
_MAX_DIFFERENCE = (0.25, 0.06)
# Residuals above this multiple of the median count less (Huber).
_HUBER_FACTOR = 1.5
# Standard deviations of scale and relative offset without other information, and of a sample.
_PRIOR_DEVIATION, _SAMPLE_DEVIATION = 0.2, 0.02
# Relative step of numeric derivatives.
_STEP = 0.01
# A sample is on an edge if its neighbours differ by more than this ratio of its depth.
_MAX_STEP_RATIO = 0.04
# The result is used if it reduces the median difference at samples that did not take part to this ratio.
_MAX_REMAINING_RATIO = 0.95
_MAX_CHANGE = 0.5


@dataclass(frozen=True)
class _ViewSamples:
    """Depth map of a view, and samples of it.

    Attributes
    ----------
    depth : (h, w) float32.
    rays : (k, 3) directions through the samples in camera axes, with unit depth.
    values : (k,) depth of the samples.
    """

    frame: Frame
    pose: Pose
    depth: NDArray[np.float32]
    rays: NDArray[np.float64]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class _Links:
    """Samples of views that other views see.

    Attributes
    ----------
    source, target : (k,) view of the sample, and the view that sees it.
    rays, values : (k, 3), (k,) as in `_ViewSamples`.
    """

    source: NDArray[np.intp]
    target: NDArray[np.intp]
    rays: NDArray[np.float64]
    values: NDArray[np.float64]

    def select(self, kept: NDArray[Any]) -> _Links:
        return _Links(self.source[kept], self.target[kept], self.rays[kept], self.values[kept])


def align_predicted_depth(frames: Sequence[Frame]) -> list[Frame]:
    """Correct the scale and offset of predicted depth maps, if the views then agree better.

    Reports the correction. Frames without a pose, and scans in which views do not overlap, stay unchanged.
    """
    posed = [place for place, frame in enumerate(frames) if frame.world_from_camera is not None]
    if len(posed) < 2:
        return list(frames)
    views = [_sample_view(frames[place]) for place in posed]
    links = _find_links(views)
    if len(links.source) < 2:
        return list(frames)
    # Half of the samples decide whether the result is better.
    is_fitted = np.arange(len(links.source)) % 2 == 0
    factors = _fit(views, links.select(is_fitted))
    other = links.select(~is_fitted)
    before, after = (_measure(views, other, numbers) for numbers in (_identity(len(views)), factors))
    if not after <= _MAX_REMAINING_RATIO * before:
        return list(frames)
    corrected = list(frames)
    for place, (scale, offset) in zip(posed, factors.tolist(), strict=True):
        corrected[place] = _correct_frame(frames[place], scale, offset)
    emit(
        SCAN_DEPTH_ALIGNED.info(
            "predicted depth of {count:,} views is multiplied by {lowest:.3g} to {highest:.3g}, with an "
            "offset: overlapping views then differ by {after:.2%} instead of {before:.2%} (median)",
            count=len(views),
            lowest=float(factors[:, 0].min()),
            highest=float(factors[:, 0].max()),
            before=before,
            after=after,
        )
    )
    return corrected


def _correct_frame(frame: Frame, scale: float, offset: float) -> Frame:
    source = frame.depth
    assert isinstance(source, PackedImage), "predicted depth is in a container"
    return replace(
        frame, depth=PackedImage(source.file, source.name, partial(_load_corrected, source, scale, offset))
    )


def _load_corrected(source: PackedImage, scale: float, offset: float) -> NDArray[np.float32]:
    raw = source.load()
    return np.where(raw > 0, np.maximum(scale * raw + offset, 0), 0).astype(np.float32)


def _sample_view(frame: Frame) -> _ViewSamples:
    """Sample the depth of a view on a grid, without edges."""
    depth = read_depth(frame)
    assert depth is not None
    assert frame.world_from_camera is not None
    height, width = depth.shape
    columns, rows = (
        np.unique(((np.arange(count) + 0.5) * size / count).astype(int).clip(1, size - 2))
        for count, size in zip(_GRID, (width, height), strict=True)
    )
    rows, columns = (grid.ravel() for grid in np.meshgrid(rows, columns, indexing="ij"))
    value = depth[rows, columns]
    across = np.abs(depth[rows, columns + 1] - depth[rows, columns - 1])
    down = np.abs(depth[rows + 1, columns] - depth[rows - 1, columns])
    kept = (value > 0) & (np.maximum(across, down) < _MAX_STEP_RATIO * value)
    camera = frame.camera
    rays = np.stack(
        [(columns - camera.cx) / camera.fx, (rows - camera.cy) / camera.fy, np.ones(len(rows))], axis=1
    )
    return _ViewSamples(frame, frame.world_from_camera, depth, rays[kept], value[kept].astype(np.float64))


def _find_links(views: Sequence[_ViewSamples]) -> _Links:
    """Find the samples of each view that other views see; at most `_MAX_PARTNERS` views each."""
    links = []
    for i, partners in enumerate(_find_partners(views)):
        view = views[i]
        points = (view.rays * view.values[:, None]) @ view.pose[:3, :3].T + view.pose[:3, 3]
        for j in partners:
            seen = _project(views[j], points)[2]
            count = int(np.count_nonzero(seen))
            links.append(_Links(np.full(count, i), np.full(count, j), view.rays[seen], view.values[seen]))
    if not links:
        return _Links(np.zeros(0, np.intp), np.zeros(0, np.intp), np.zeros((0, 3)), np.zeros(0))
    return _Links(
        *(
            np.concatenate([getattr(one, name) for one in links])
            for name in ("source", "target", "rays", "values")
        )
    )


def _find_partners(views: Sequence[_ViewSamples]) -> list[list[int]]:
    """Find the views that see most of each view, from some of its samples."""
    poses = np.array([view.pose for view in views])
    cameras = np.array([(c.fx, c.fy, c.cx, c.cy, c.width, c.height) for c in (v.frame.camera for v in views)])
    fx, fy, cx, cy, width, height = cameras.T[:, :, None]
    partners: list[list[int]] = []
    for i, view in enumerate(views):
        if not len(view.values):
            partners.append([])
            continue
        some = slice(None, None, max(1, len(view.values) // _PARTNER_SAMPLES))
        points = (view.rays[some] * view.values[some, None]) @ view.pose[:3, :3].T + view.pose[:3, 3]
        x, y, z = np.einsum("nkx,nxc->cnk", points[None] - poses[:, None, :3, 3], poses[:, :3, :3])
        near = np.maximum(z, 1e-12)
        with np.errstate(over="ignore"):
            u, v = fx * x / near + cx, fy * y / near + cy
        ratio = ((z > 0) & (u >= 0) & (u < width) & (v >= 0) & (v < height)).mean(axis=1)
        ratio[i] = 0
        # Ties are broken by the distance of the views in time.
        order = np.lexsort((np.abs(np.arange(len(views)) - i), -ratio))[:_MAX_PARTNERS]
        partners.append([int(j) for j in order if ratio[j] >= _MIN_SEEN_RATIO])
    return partners


def _project(
    view: _ViewSamples, points: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Project world points into a view.

    Returns
    -------
    Depth the view predicts there, depth of the points, and True where the view has depth.
    """
    camera, height, width = view.frame.camera, *view.depth.shape
    x, y, z = ((points - view.pose[:3, 3]) @ view.pose[:3, :3]).T
    ahead = z > 0
    near = np.where(ahead, z, 1.0)
    with np.errstate(over="ignore", invalid="ignore"):
        columns, rows = camera.fx * x / near + camera.cx, camera.fy * y / near + camera.cy
    inside = ahead & (columns >= 0) & (columns < width - 1) & (rows >= 0) & (rows < height - 1)
    columns, rows = np.where(inside, columns, 0.0), np.where(inside, rows, 0.0)
    left, top = columns.astype(int), rows.astype(int)
    corners = np.stack([view.depth[top + i, left + j] for i in (0, 1) for j in (0, 1)]).astype(np.float64)
    across, down = columns - left, rows - top
    weights = np.stack([(1 - down) * (1 - across), (1 - down) * across, down * (1 - across), down * across])
    predicted = np.sum(weights * corners, axis=0)
    is_edge = corners.max(axis=0) - corners.min(axis=0) > _MAX_STEP_RATIO * predicted
    return predicted, z, inside & (corners.min(axis=0) > 0) & ~is_edge


def _identity(count: int) -> NDArray[np.float64]:
    return np.tile([1.0, 0.0], (count, 1))


def _compare(
    views: Sequence[_ViewSamples], links: _Links, factors: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Compare samples with the views that see them.

    Returns
    -------
    Derivatives (k, 4) of the difference by scale and offset of both views, differences (k,), and True where
    the target has depth. The difference is that of the logarithms, since relative to uncorrected depth,
    smaller scales would always agree better.
    """
    derivatives, differences = np.zeros((len(links.source), 4)), np.zeros(len(links.source))
    has_depth = np.zeros(len(links.source), bool)
    scale, offset = factors[links.source].T
    depth = np.maximum(scale * links.values + offset, 1e-12)
    for j, view in enumerate(views):
        rows = np.flatnonzero(links.target == j)
        for i in np.unique(links.source[rows]):
            of_pair = rows[links.source[rows] == i]
            pose, far = views[i].pose, depth[of_pair]
            rays = links.rays[of_pair] @ pose[:3, :3].T
            # A moved point is seen at another pixel of the target, so the derivative is numeric.
            (difference, predicted, known), (moved, _, is_known) = (
                _compare_points(view, rays * (step * far)[:, None] + pose[:3, 3], factors[j])
                for step in (1.0, 1 + _STEP)
            )
            has_depth[of_pair] = known & is_known
            slope = (moved - difference) / (_STEP * far)
            expected = factors[j, 0] * predicted + factors[j, 1]
            derivatives[of_pair] = np.stack(
                [links.values[of_pair] * slope, slope, -predicted / expected, -1 / expected], axis=1
            )
            differences[of_pair] = difference
    return derivatives, differences, has_depth


def _compare_points(
    view: _ViewSamples, points: NDArray[np.float64], numbers: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.bool_]]:
    """Compare the depth of points with the corrected depth of a view.

    Returns
    -------
    Differences (k,) of the logarithms, predicted depth, and True where the view has depth; else 0 and 1.
    """
    predicted, seen, known = _project(view, points)
    expected = numbers[0] * predicted + numbers[1]
    known &= expected > 0
    seen, expected, predicted = (np.where(known, one, 1.0) for one in (seen, expected, predicted))
    return np.where(known, np.log(seen / expected), 0.0), predicted, known


def _measure(views: Sequence[_ViewSamples], links: _Links, factors: NDArray[np.float64]) -> float:
    """Return the median relative difference of samples on the same surface."""
    _, difference, has_depth = _compare(views, links, factors)
    size = np.abs(difference[has_depth])
    # Limited instead of left out, so that a wrong result cannot hide.
    return float(np.median(np.minimum(size, _MAX_DIFFERENCE[0]))) if len(size) else np.inf


def _fit(views: Sequence[_ViewSamples], links: _Links) -> NDArray[np.float64]:
    """Fit scale and offset (n, 2) of all views."""
    count = len(views)
    factors = _identity(count)
    # Offsets are relative to the median depth, so that scale and offset have similar size.
    depth = np.array([np.median(view.values) if len(view.values) else 1.0 for view in views])
    unit = np.stack([np.ones(count), depth], axis=1)
    limits = np.geomspace(*_MAX_DIFFERENCE, _ITERATIONS)
    prior = (_SAMPLE_DEVIATION / _PRIOR_DEVIATION) ** 2
    for limit in limits:
        derivatives, difference, has_depth = _compare(views, links, factors)
        kept = has_depth & (np.abs(difference) < limit)
        if not kept.any():
            break
        size = np.abs(difference[kept])
        huber = _HUBER_FACTOR * max(float(np.median(size)), 1e-6)
        weights = np.minimum(1, huber / np.maximum(size, 1e-12))
        columns = np.concatenate(
            [2 * links.source[kept, None] + (0, 1), 2 * links.target[kept, None] + (0, 1)], axis=1
        )
        rows = derivatives[kept] * unit.reshape(-1)[columns]
        matrix, right = np.zeros((2 * count, 2 * count)), np.zeros(2 * count)
        for a in range(4):
            np.add.at(right, columns[:, a], -weights * rows[:, a] * difference[kept])
            for b in range(4):
                np.add.at(matrix, (columns[:, a], columns[:, b]), weights * rows[:, a] * rows[:, b])
        change = (_identity(count) - factors) / unit
        matrix[np.diag_indices(2 * count)] += prior
        right += prior * change.reshape(-1)
        factors = factors + np.linalg.solve(matrix, right).reshape(-1, 2) * unit
        factors[:, 0] = factors[:, 0].clip(1 - _MAX_CHANGE, 1 + _MAX_CHANGE)
        factors[:, 1] = factors[:, 1].clip(-_MAX_CHANGE * depth, _MAX_CHANGE * depth)
    return factors
