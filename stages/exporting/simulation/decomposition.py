"""Decomposition of a surface into convex parts that contain it.

A solid is divided by CoACD: Wei, Liu, Ling and Su, "Approximate convex decomposition for 3D meshes with
collision-aware concavity and tree search", 2022. An open surface has no inside; it is halved until the
hull of each portion is flat enough. Every triangle is then inside one part or is cut into such pieces, and
parts with too many corners are replaced by slightly larger ones with fewer.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.exporting.codes import EXPORT_DECOMPOSITION_FAILED
from scanloom.stages.exporting.simulation.collision_proof import (
    SolidDistance,
    bisect_triangles,
    is_within_excess,
    measure_diagonal,
    measure_longest_sides,
)
from scanloom.stages.exporting.simulation.convex_part import (
    ConvexPart,
    build_part,
    split_part,
    thicken_points,
)
from scanloom.stages.files.subprocess_reader import SubprocessDiedError, run_reader_subprocess
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# PhysX uses at most 64 corners of a hull on the GPU.
MAX_CORNERS = 64
# CoACD's time grows with the triangle count. The parts are grown to the full mesh afterwards.
_MAX_TRIANGLES = 3000
_MAX_CPU_SECONDS = 3600.0
# Shares of the permitted excess: hull of a portion, growth to cover a triangle, and removal of corners.
# Corners are removed up to a small growth; the larger one is accepted if MAX_CORNERS allow no less. An object
# rests on its outermost corners, so that growth there moves it.
_HULL_RATIO = 0.75
_COVER_RATIO = 0.05
_CORNER_RATIO, _MAX_CORNER_RATIO = 0.03, 0.25
_BACKING_RATIO = 0.2
# Parts that need more corners than MAX_CORNERS are halved, at most so often.
_MAX_HALVINGS = 4
# Step of written coordinates, as a ratio of the bounding-box diagonal.
_GRID_RATIO = 1e-6


def decompose_solid(solid: Mesh, max_excess_m: float, concavity_m: float) -> list[ConvexPart]:
    """Decompose a closed mesh into convex parts that contain its surface.

    Parameters
    ----------
    max_excess_m : largest permitted distance from a part to the solid; it limits growth of the parts.
    concavity_m : maximum concavity of a part, as CoACD estimates it.

    Raises
    ------
    StageError
        If CoACD fails.
    """
    light = solid
    if len(solid.triangles) > _MAX_TRIANGLES:
        light = simplify(solid.with_(colors=None), triangles=_MAX_TRIANGLES).mesh
    points = _run_coacd(light, concavity_m)
    return _finish_parts([build_part(thicken_points(one)) for one in points], solid, max_excess_m)


def decompose_surface(surface: Mesh, max_excess_m: float) -> list[ConvexPart]:
    """Decompose an open mesh into thin convex parts that contain it.

    Parts of flat regions are slabs that extend behind the surface.
    """
    distance = SolidDistance(surface, is_solid=False)
    limit, backing = _HULL_RATIO * max_excess_m, _BACKING_RATIO * max_excess_m
    done: list[Floats] = []
    pending = [surface.vertices[surface.triangles]]
    while pending:
        hulls = [build_part(_back_pieces(one, backing)) for one in pending]
        divided: list[Floats] = []
        for pieces, is_within in zip(pending, is_within_excess(distance, hulls, limit), strict=True):
            if is_within or (len(pieces) == 1 and measure_longest_sides(pieces)[0] <= max_excess_m):
                done.append(pieces)
            else:
                divided += _divide_pieces(pieces)
        pending = divided
    done = _merge_pieces(done, distance, limit, backing)
    return _finish_parts([build_part(_back_pieces(one, backing)) for one in done], surface, max_excess_m)


def _merge_pieces(
    groups: list[Floats], distance: SolidDistance, limit_m: float, backing_m: float
) -> list[Floats]:
    """Merge neighbouring groups of pieces whose common hull is within the limit, nearest pairs first."""
    is_new = np.ones(len(groups), bool)
    while is_new.any():
        pairs = _pair_neighbours(groups, is_new)
        merged = [np.concatenate((groups[i], groups[j])) for i, j in pairs]
        hulls = [build_part(_back_pieces(one, backing_m)) for one in merged]
        if not hulls:
            break
        accepted = is_within_excess(distance, hulls, limit_m).tolist()
        used = {index for pair, is_within in zip(pairs, accepted, strict=True) if is_within for index in pair}
        kept = [one for index, one in enumerate(groups) if index not in used]
        made = [one for one, is_within in zip(merged, accepted, strict=True) if is_within]
        groups = kept + made
        is_new = np.arange(len(groups)) >= len(kept)
    return groups


def _pair_neighbours(groups: list[Floats], is_new: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Match groups with overlapping bounding boxes, at least one of them new, the smallest unions first."""
    low = np.array([one.min(axis=(0, 1)) for one in groups])
    high = np.array([one.max(axis=(0, 1)) for one in groups])
    candidates = []
    for index in np.flatnonzero(is_new).tolist():
        near = ((low <= high[index]) & (high >= low[index])).all(axis=1)
        near[index] = False
        others = np.flatnonzero(near)
        sizes = np.linalg.norm(
            np.maximum(high[others], high[index]) - np.minimum(low[others], low[index]), axis=1
        )
        candidates += [
            (size, index, other) for size, other in zip(sizes.tolist(), others.tolist(), strict=True)
        ]
    pairs: list[tuple[int, int]] = []
    used: set[int] = set()
    for _, index, other in sorted(candidates):
        if index not in used and other not in used:
            used |= {index, other}
            pairs.append((index, other))
    return pairs


def _run_coacd(mesh: Mesh, concavity_m: float) -> list[Floats]:
    with tempfile.TemporaryDirectory(prefix="scanloom-", ignore_cleanup_errors=True) as kept:
        source, target = Path(kept) / "mesh.npz", Path(kept) / "parts.npz"
        np.savez(source, vertices=mesh.vertices, triangles=mesh.triangles)
        try:
            run_reader_subprocess(
                "scanloom.stages.exporting.simulation.coacd_process",
                [str(source), str(target), repr(concavity_m)],
                _MAX_CPU_SECONDS,
            )
        except SubprocessDiedError as error:
            raise StageError(
                EXPORT_DECOMPOSITION_FAILED,
                "CoACD could not divide the mesh into convex parts ({detail})",
                remedy="simplify or repair the mesh first.",
                detail=error,
            ) from error
        with np.load(target) as found:
            points, counts = found["points"], found["counts"]
    return [one for one in np.split(points, np.cumsum(counts)[:-1]) if len(one)]


def _back_pieces(pieces: Floats, depth_m: float) -> Floats:
    """Return the corners of pieces and copies behind the surface; their hull has a volume."""
    points = np.unique(pieces.reshape(-1, 3), axis=0)
    a, b, c = pieces.transpose(1, 0, 2)
    normal = np.cross(b - a, c - a).sum(axis=0)
    length = np.linalg.norm(normal)
    if length > 0:
        points = np.concatenate((points, points - normal / length * depth_m))
    return thicken_points(points)


def _divide_pieces(pieces: Floats) -> list[Floats]:
    """Divide pieces in two halves along their longest axis; long pieces are bisected first."""
    centers = pieces.mean(axis=1)
    corners = pieces.reshape(-1, 3)
    _, axes = np.linalg.eigh(np.cov((corners - corners.mean(axis=0)).T))
    axis = axes[:, 2]
    extent = np.ptp(corners @ axis)
    is_long = np.ptp(pieces @ axis, axis=1) > extent / 2
    if is_long.any():
        pieces = np.concatenate((pieces[~is_long], bisect_triangles(pieces[is_long])))
        centers = pieces.mean(axis=1)
    along = centers @ axis
    middle = ((corners @ axis).min() + (corners @ axis).max()) / 2
    is_low = along <= middle
    return [half for half in (pieces[is_low], pieces[~is_low]) if len(half)]


def _finish_parts(parts: list[ConvexPart], surface: Mesh, max_excess_m: float) -> list[ConvexPart]:
    parts = _cover_surface(parts, surface, max_excess_m)
    step = compute_grid_step(surface)
    return [
        finished for part in parts for finished in _reduce_corners(part, max_excess_m, step, _MAX_HALVINGS)
    ]


def compute_grid_step(surface: Mesh) -> float:
    """Return the step of written coordinates, a power of ten in metres."""
    return float(10.0 ** np.floor(np.log10(_GRID_RATIO * measure_diagonal(surface.vertices))))


def _cover_surface(parts: list[ConvexPart], surface: Mesh, max_excess_m: float) -> list[ConvexPart]:
    """Grow parts until each triangle, or each of its pieces, is inside one part."""
    added: list[list[Floats]] = [[] for _ in parts]
    pieces = surface.vertices[surface.triangles]
    tolerance = _COVER_RATIO * max_excess_m
    while len(pieces):
        growth, chosen = _find_nearest_parts(pieces, parts, max_excess_m)
        is_short = measure_longest_sides(pieces) <= tolerance
        is_assigned = (growth <= tolerance) | is_short
        for index in np.unique(chosen[is_assigned & (growth > 0)]).tolist():
            added[index].append(pieces[is_assigned & (growth > 0) & (chosen == index)].reshape(-1, 3))
        pieces = bisect_triangles(pieces[~is_assigned])
    return [
        build_part(np.concatenate((part.vertices, *more))) if more else part
        for part, more in zip(parts, added, strict=True)
    ]


def _find_nearest_parts(
    pieces: Floats, parts: Sequence[ConvexPart], reach_m: float
) -> tuple[Floats, NDArray[np.int64]]:
    """Return the height (n,) of triangles above the planes of their nearest part, and that part (n,).

    The height is 0 for a triangle inside the part. Parts farther than `reach_m` are only compared if no
    other is nearer.
    """
    growth = np.full(len(pieces), np.inf)
    chosen = np.zeros(len(pieces), np.int64)
    low, high = pieces.min(axis=1), pieces.max(axis=1)
    for reach in (reach_m, np.inf):
        missing = growth == np.inf
        if not missing.any():
            break
        for index, part in enumerate(parts):
            bottom, top = part.vertices.min(axis=0) - reach, part.vertices.max(axis=0) + reach
            rows = np.flatnonzero(missing & ((low >= bottom) & (high <= top)).all(axis=1))
            heights = part.compute_heights(pieces[rows].reshape(-1, 3)).reshape(-1, 3).max(axis=1, initial=0)
            heights[heights <= part.slack_m] = 0
            closer = heights < growth[rows]
            growth[rows[closer]], chosen[rows[closer]] = heights[closer], index
    return growth, chosen


def _reduce_corners(
    part: ConvexPart, max_excess_m: float, step_m: float, halvings: int
) -> Iterator[ConvexPart]:
    """Yield parts with at most MAX_CORNERS corners on a grid, whose union contains the part.

    The hull of a few corners is scaled until it contains all. A part that would grow too much is halved.
    """
    max_growth = _MAX_CORNER_RATIO * max_excess_m
    center = part.vertices.mean(axis=0)
    reduced, scale = _choose_corners(part, center, _CORNER_RATIO * max_excess_m)
    radius = float(np.linalg.norm(part.vertices - center, axis=1).max())
    if (scale - 1) * radius > max_growth and halvings > 0:
        # A triangle across the cut is then inside one of the halves, or has pieces that are.
        for half in split_part(part, max_growth):
            yield from _reduce_corners(half, max_excess_m, step_m, halvings - 1)
        return
    # Moving a corner to the grid moves the hull by at most half a cell's diagonal.
    depth = float(-(reduced.planes[:, :3] @ center + reduced.planes[:, 3]).max())
    scale += step_m / depth
    grid = np.rint((center + (reduced.vertices - center) * scale) / step_m)
    yield build_part(np.unique(grid, axis=0) / round(1 / step_m) if step_m < 1 else grid * step_m)


def _choose_corners(part: ConvexPart, center: Floats, max_growth_m: float) -> tuple[ConvexPart, float]:
    """Return the hull of chosen corners, and the scale at which it contains the part."""
    from scipy.spatial import ConvexHull

    offsets = part.vertices - center
    radius = float(np.linalg.norm(offsets, axis=1).max())
    _, axes = np.linalg.eigh(np.cov(offsets.T))
    along = offsets @ axes
    first = np.unique(np.concatenate((along.argmin(axis=0), along.argmax(axis=0))))
    chosen = _make_volume(offsets, first.tolist())
    hull = ConvexHull(offsets[chosen], incremental=True)
    scale = np.inf
    while True:
        planes = hull.equations
        # Gauge: factor by which the hull must grow about its centre to contain each corner.
        depths = -planes[:, 3]
        if depths.min() > 0:
            gauges = (offsets @ planes[:, :3].T / depths).max(axis=1)
            gauges[chosen] = 1.0
            scale = max(1.0, float(gauges.max()))
            following = int(gauges.argmax())
        else:
            # The centre is outside, so the factor does not exist yet.
            heights = (offsets @ planes[:, :3].T + planes[:, 3]).max(axis=1)
            following = int(heights.argmax())
        if following in chosen or len(chosen) == MAX_CORNERS or (scale - 1) * radius <= max_growth_m:
            break
        chosen.append(following)
        hull.add_points(offsets[[following]])
    if not np.isfinite(scale):
        return part, 1.0
    return build_part(part.vertices[chosen]), scale


def _make_volume(points: Floats, chosen: list[int]) -> list[int]:
    """Add points until the chosen ones span a volume."""
    while len(chosen) < 4 or np.linalg.matrix_rank(points[chosen] - points[chosen[0]]) < 3:
        basis = points[chosen] - points[chosen[0]]
        _, sizes, axes = np.linalg.svd(basis)
        spanned = axes[: int((sizes > 1e-9 * max(sizes[0], 1e-300)).sum())]
        rest = points - points[chosen[0]]
        rest = rest - rest @ spanned.T @ spanned
        following = int(np.linalg.norm(rest, axis=1).argmax())
        if following in chosen:
            return list(range(len(points)))
        chosen.append(following)
    return chosen
