"""Fewest triangles at any bound up to the one asked for.

Patches grow greedily, and at a looser bound not always better: near the tip of a cone, a sector that may be
thicker takes in what is thin enough of the next, and the border between the two turns from a line into
stairs. What holds at a tighter bound holds at a looser one too. So patches grow at tighter ones as well, and
the result that leaves fewest triangles is taken.

The tighter bounds are parts of the diagonal, the same whatever was asked for: what a looser bound tries then
has in it what a tighter one tries, but for the very bound that was asked for. Small meshes try them all; of
others, nearly all time would go into bounds that leave more, and the search ends where that shows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.progress import Progress

# Of the diagonal, by halves: 1 to 1e-6. Steps of four missed a fourteenth of what a room can lose.
_HALVINGS = 20

# Bounds from one half to the next that small meshes try just below the one that was asked for. With the
# halves alone, a bound between two of them now and then left 8 % fewer than a looser one.
_BETWEEN = 8

# Nobody waits for meshes of so many triangles: all bounds are tried.
_SMALL = 1 << 13

# Where a tighter bound leaves so many times the fewest, still tighter ones leave more yet, on scans.
_FAR_WORSE = 1.1

# And so many in a row that leave no fewer are enough.
_IN_VAIN = 2

# But not bounds above this part of the diagonal, where a room without colours had 12,646, 16,617 and 6,376
# triangles at tighter and tighter ones: such patches take in whole things.
_ERRATIC = 1 / 64

# Maximum number of edges in the sample that counts flat ones.
_SAMPLED_EDGES = 20_000

# Spreads edge keys, so that the sample follows no pattern of the mesh (Knuth: multiplicative hashing).
_EDGE_SPREAD = np.uint64(0x9E3779B97F4A7C15)


class _Lighter(Protocol):
    """What is to have few triangles."""

    @property
    def triangles(self) -> NDArray[np.int32]:
        """Return its triangles (q, 3)."""
        ...

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Return how far each patch is off (k, 2), metres and levels."""
        ...

    @property
    def is_partial(self) -> bool:
        """Return whether work was ended before it was done."""
        ...


R = TypeVar("R", bound=_Lighter)


@dataclass(frozen=True)
class Fewest(Generic[R]):
    """The result with fewest triangles.

    Attributes
    ----------
    result : what was made.
    max_shape : metres, the bound at which it was.
    is_partial : whether `progress` asked for what there is, before or after.
    """

    result: R
    max_shape: float
    is_partial: bool


def fewest_triangles(
    simplified: Callable[[float, Progress], R],
    *,
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    max_shape: float,
    diagonal: float,
    progress: Progress,
) -> Fewest[R]:
    """Simplify at a bound and at tighter ones, and return the result that has fewest triangles.

    Of results with as many, that of the tightest bound. Nothing depends on time or threads.

    Parameters
    ----------
    simplified : called with a bound (metres) and the progress of its own.
    vertices, triangles : (n, 3) float64, metres, and (m, 3) int32: what is simplified.
    max_shape : metres, the bound that was asked for.
    diagonal : metres, of the bounding box.
    progress : of all together.
    """
    telling = _parts_of(progress)
    fewest, grown_at = simplified(max_shape, next(telling)), max_shape
    is_partial, attained = fewest.is_partial, _attained(fewest)
    is_small, is_enough, in_vain = len(triangles) <= _SMALL, False, 0
    count = len(fewest.triangles)
    flattest = diagonal / 2**_HALVINGS
    for bound in _bounds_below(max_shape, diagonal, _BETWEEN if is_small else 1):
        # Where all triangles stay, a tighter bound frees none.
        if is_partial or count >= len(triangles):
            break
        least = len(fewest.triangles)
        if not is_small:
            # No patch came up to a bound like that: few would grow otherwise.
            if bound > attained or (is_enough and bound > flattest):
                continue
            # Flat faces have stairs for borders at any bound but the tightest, and scans have none.
            if bound == flattest and fewest_patches(vertices, triangles, bound) >= least:
                continue
        found = simplified(bound, next(telling))
        is_partial, attained = found.is_partial, min(attained, _attained(found))
        count = len(found.triangles)
        if count <= least:
            fewest, grown_at = found, bound
        in_vain = 0 if count < least else in_vain + 1
        is_far_worse = count > _FAR_WORSE * least
        is_enough = is_enough or (bound < _ERRATIC * diagonal and (is_far_worse or in_vain >= _IN_VAIN))
    return Fewest(fewest, grown_at, is_partial)


def _attained(result: _Lighter) -> float:
    return float(result.bounds.reshape(-1, 2)[:, 0].max(initial=0.0))


def fewest_patches(vertices: NDArray[np.float64], triangles: NDArray[np.int32], bound: float) -> float:
    """Estimate the minimum number of patches whose triangles lie in their neighbours' planes.

    A connected patch has an inner edge for each triangle but the first. So the number of patches is at least
    that of triangles minus flat edges, which are counted in a sample of edges. The sample is always the same.

    Parameters
    ----------
    vertices : (n, 3) float64, metres.
    triangles : (m, 3) int32.
    bound : distance that a vertex may have from its neighbour's plane, metres.

    Returns
    -------
    float
        0 if the flat edges would suffice for a single patch.
    """
    opposite = triangles[:, [2, 0, 1]].reshape(-1)
    a, b = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).T
    key = a.astype(np.uint64) * np.uint64(len(vertices)) + b.astype(np.uint64)
    every = max(1, len(key) // 2 // _SAMPLED_EDGES)
    picked = np.flatnonzero((key * _EDGE_SPREAD >> np.uint64(32)) % np.uint64(every) == 0)
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
    within = every * int((heights <= bound * lengths).sum())
    return max(0.0, float(len(triangles) - within))


def _bounds_below(max_shape: float, diagonal: float, between: int) -> Iterator[float]:
    """Yield the bounds that are tried below one, loosest first: halves, and more just below it."""
    for halvings in range(_HALVINGS + 1):
        # Parts that floats hold exactly are the same everywhere.
        for step in range(between, 0, -1):
            bound = diagonal / 2**halvings * (between + step) / (2 * between)
            if 0 < bound < max_shape and (step == between or 2 * bound > max_shape):
                yield bound


def _parts_of(progress: Progress) -> Iterator[Progress]:
    """Yield the progress of one piece of work after the other, each half of what was left by those before.

    How many there will be is known at the end only, and what is told must neither go back nor beyond its end.
    """
    all_of_it = 0
    before, share = 0.0, 0.5
    while True:

        def part(done: int, total: int, before: float = before, share: float = share) -> object:
            nonlocal all_of_it
            all_of_it = all_of_it or total
            done_of_all = before + share * (done / total if total else 0.0)
            return progress(int(all_of_it * done_of_all), all_of_it)

        yield part
        before, share = before + share, share / 2
