"""Search for the bound that leaves the fewest triangles.

No bound above the requested one is tried.

Patches grow greedily, so looser bounds do not always give better patches. Near the tip of a cone, a thicker
sector takes triangles of the next one, and their straight border becomes a staircase. Results at a tighter
bound also satisfy the looser one. So tighter bounds are tried too, and the result with the fewest triangles
is taken.

The tighter bounds are fixed fractions of the diagonal. A looser request therefore tries everything that a
tighter request tries, except the tighter request itself. Small meshes try all bounds. For large meshes the
search stops when tighter bounds only leave more triangles, because trying all would dominate the run time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.progress import Progress

# Bounds are halved from the diagonal down to 1e-6 of it. Steps by a factor of four gave up to 7 % more
# triangles for a room.
_HALVINGS = 20

# Bounds per halving that small meshes try just below the requested one. With halvings alone, a bound between
# two of them sometimes left 8 % fewer triangles than a looser one.
_BOUNDS_PER_HALVING = 8

# Triangles. Smaller meshes are fast enough to try all bounds.
_MAX_EXHAUSTIVE_TRIANGLES = 1 << 13

# If a tighter bound leaves more triangles than the best by this factor, even tighter ones leave more still.
# Measured on scans.
_STOP_COUNT_RATIO = 1.1

# Stop after this many consecutive bounds without improvement.
_MAX_FAILED_BOUNDS = 2

# Ratio of the diagonal above which the search does not stop. Patches that thick absorb complete objects, and
# counts are erratic: a room without colours had 12,646, 16,617 and 6,376 triangles at successively tighter
# bounds.
_MAX_STOP_BOUND_RATIO = 1 / 64

# Maximum number of edges in the sample that counts flat ones.
_SAMPLED_EDGES = 20_000

# Multiplicative hashing (Knuth), so that the sample does not follow the mesh layout.
_EDGE_SPREAD = np.uint64(0x9E3779B97F4A7C15)


class _PlanarResult(Protocol):
    """Result of one simplification."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """Triangles (q, 3)."""
        ...

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Bounds (k, 2) of each patch, metres and levels."""
        ...

    @property
    def is_partial(self) -> bool:
        """True if the simplification was stopped early on request."""
        ...


R = TypeVar("R", bound=_PlanarResult)


@dataclass(frozen=True)
class FewestTriangles(Generic[R]):
    """Result with the fewest triangles.

    Attributes
    ----------
    result : result of the best simplification.
    max_shape : metres, bound of that simplification.
    is_partial : True if `progress` requested an early stop in any simplification.
    """

    result: R
    max_shape: float
    is_partial: bool


def search_fewest_triangles(
    run_at_bound: Callable[[float, Progress], R],
    *,
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    max_shape: float,
    diagonal: float,
    progress: Progress,
) -> FewestTriangles[R]:
    """Simplify at a bound and tighter ones; return the fewest triangles.

    Ties are resolved in favour of the tightest bound. The result does not depend on timing or threads.

    Parameters
    ----------
    run_at_bound : called with a bound in metres and a progress callback.
    vertices, triangles : the input, (n, 3) float64 in metres and (m, 3) int32.
    max_shape : metres, the requested bound.
    diagonal : metres, diagonal of the bounding box.
    progress : progress of the complete search.
    """
    progress_parts = _split_progress(progress)
    fewest, best_bound = run_at_bound(max_shape, next(progress_parts)), max_shape
    is_partial, attained = fewest.is_partial, _compute_attained_shape(fewest)
    is_small, can_stop, failed_bounds = len(triangles) <= _MAX_EXHAUSTIVE_TRIANGLES, False, 0
    count = len(fewest.triangles)
    tightest = diagonal / 2**_HALVINGS
    for bound in _iterate_tighter_bounds(max_shape, diagonal, _BOUNDS_PER_HALVING if is_small else 1):
        # If every triangle stays, tighter bounds cannot remove any.
        if is_partial or count >= len(triangles):
            break
        min_count = len(fewest.triangles)
        if not is_small:
            # No patch reached this bound, so few would differ.
            if bound > attained or (can_stop and bound > tightest):
                continue
            # Flat faces get staircase borders at any bound but the tightest one, which is slow. It is tried
            # only if the mesh has flat faces; scans have none.
            if bound == tightest and estimate_min_patches(vertices, triangles, bound) >= min_count:
                continue
        candidate = run_at_bound(bound, next(progress_parts))
        is_partial, attained = candidate.is_partial, min(attained, _compute_attained_shape(candidate))
        count = len(candidate.triangles)
        if count <= min_count:
            fewest, best_bound = candidate, bound
        failed_bounds = 0 if count < min_count else failed_bounds + 1
        is_far_worse = count > _STOP_COUNT_RATIO * min_count
        can_stop = can_stop or (
            bound < _MAX_STOP_BOUND_RATIO * diagonal and (is_far_worse or failed_bounds >= _MAX_FAILED_BOUNDS)
        )
    return FewestTriangles(fewest, best_bound, is_partial)


def _compute_attained_shape(result: _PlanarResult) -> float:
    return float(result.bounds.reshape(-1, 2)[:, 0].max(initial=0.0))


def estimate_min_patches(vertices: NDArray[np.float64], triangles: NDArray[np.int32], bound: float) -> float:
    """Estimate the minimum number of exactly planar patches.

    A connected patch has at least one inner edge for each triangle but the first. So the number of patches is
    at least the triangle count minus the number of flat edges. Flat edges are counted in a fixed sample of
    edges.

    Parameters
    ----------
    vertices : (n, 3) float64, metres.
    triangles : (m, 3) int32.
    bound : metres, distance that a vertex may have from its neighbour's plane.

    Returns
    -------
    float
        0 if the flat edges suffice for a single patch.
    """
    opposite = triangles[:, [2, 0, 1]].reshape(-1)
    a, b = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).T
    key = a.astype(np.uint64) * np.uint64(len(vertices)) + b.astype(np.uint64)
    sampling_step = max(1, len(key) // 2 // _SAMPLED_EDGES)
    picked = np.flatnonzero((key * _EDGE_SPREAD >> np.uint64(32)) % np.uint64(sampling_step) == 0)
    picked = picked[np.argsort(key[picked], kind="stable")]
    one = np.flatnonzero(key[picked][1:] == key[picked][:-1])
    sides, others = picked[one], opposite[picked[one + 1]]
    start, along, across, beyond = (
        vertices[a[sides]],
        vertices[b[sides]],
        vertices[opposite[sides]],
        vertices[others],
    )
    normals = np.cross(along - start, across - start)
    lengths = np.linalg.norm(normals, axis=1)
    heights = np.abs(np.einsum("ij,ij->i", normals, beyond - start))
    flat_edges = sampling_step * int((heights <= bound * lengths).sum())
    return max(0.0, float(len(triangles) - flat_edges))


def _iterate_tighter_bounds(max_shape: float, diagonal: float, bounds_per_halving: int) -> Iterator[float]:
    """Yield the bounds to try below `max_shape`, loosest first.

    They are halvings of the diagonal, and `bounds_per_halving` bounds per halving just below `max_shape`.
    """
    for halvings in range(_HALVINGS + 1):
        # These fractions are exact in floating point, so bounds are identical for all requests.
        for step in range(bounds_per_halving, 0, -1):
            bound = diagonal / 2**halvings * (bounds_per_halving + step) / (2 * bounds_per_halving)
            if 0 < bound < max_shape and (step == bounds_per_halving or 2 * bound > max_shape):
                yield bound


def _split_progress(progress: Progress) -> Iterator[Progress]:
    """Split a progress callback over an unknown number of simplifications.

    Each one gets half of the remaining range, so that progress neither goes back nor exceeds 100 %.
    """
    total_count = 0
    before, share = 0.0, 0.5
    while True:

        def report_part(done: int, total: int, before: float = before, share: float = share) -> object:
            nonlocal total_count
            total_count = total_count or total
            done_of_all = before + share * (done / total if total else 0.0)
            return progress(int(total_count * done_of_all), total_count)

        yield report_part
        before, share = before + share, share / 2
