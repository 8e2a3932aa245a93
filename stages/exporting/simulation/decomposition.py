"""Decomposition of a surface into convex parts that contain it.

A solid is divided by CoACD: Wei, Liu, Ling and Su, "Approximate convex decomposition for 3D meshes with
collision-aware concavity and tree search", 2022. An open surface has no inside; it is halved until the
hull of each portion is flat enough. Every triangle is then inside one part or is cut into such pieces, and
parts with too many corners are replaced by slightly larger ones with fewer.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import TypeAlias

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
    PartSet,
    build_box,
    build_part,
    fit_rectangle,
    split_part,
    thicken_points,
)
from scanloom.stages.files.subprocess_reader import SubprocessDiedError, run_reader_subprocess
from scanloom.stages.simplification.planar.run import planar_patches
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
_Builder: TypeAlias = Callable[[Floats], ConvexPart]

# PhysX uses at most 64 corners of a hull on the GPU.
MAX_CORNERS = 64
# CoACD's time grows with the triangle count. The parts are grown to the full mesh afterwards.
_MAX_TRIANGLES = 3000
_MAX_CPU_SECONDS = 3600.0
# CoACD's preprocessing, in the order of attempts. Its check for self-intersections aborts on some meshes.
_PREPROCESSING = ("auto", "off", "on")
# Shares of the permitted excess: hull of a portion, growth to cover a triangle, and removal of corners.
# Corners are removed up to a small growth; the larger one is accepted if MAX_CORNERS allow no less. An object
# rests on its outermost corners, so that growth there moves it.
_HULL_RATIO = 0.75
_COVER_RATIO = 0.05
_CORNER_RATIO, _MAX_CORNER_RATIO = 0.03, 0.25
_BACKING_RATIO = 0.2
# Planar patches become boxes if they are at least this wide, in multiples of the permitted excess. The bound
# on their thickness is a share of the permitted excess, and a ratio of the bounding-box diagonal.
_MIN_PATCH_SIDES = 4.0
_PATCH_RATIO, _MAX_PATCH_RATIO = 0.5, 0.005
# Size of a group of pieces that is not divided, as a ratio of the permitted excess.
_MIN_GROUP_RATIO = 0.25
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
    hulls = divide_solid(solid, concavity_m)
    return _finish_parts(hulls, solid.vertices[solid.triangles], solid, max_excess_m, PartSet([]))


def divide_solid(solid: Mesh, concavity_m: float) -> list[ConvexPart]:
    """Divide a closed mesh into the hulls of convex portions.

    Raises
    ------
    StageError
        If CoACD fails.
    """
    light = solid
    if len(solid.triangles) > _MAX_TRIANGLES:
        light = simplify(solid.with_(colors=None), triangles=_MAX_TRIANGLES).mesh
    return [build_part(thicken_points(one)) for one in _run_coacd(light, concavity_m)]


def decompose_surface(
    surface: Mesh, max_excess_m: float, obstacles: PartSet | None = None
) -> list[ConvexPart]:
    """Decompose an open mesh into thin convex parts that contain it.

    Large planar patches become boxes, other regions slabs. Both extend behind the surface.

    Parameters
    ----------
    obstacles : parts of other bodies, which the result does not touch, except next to the surface.
    """
    obstacles = PartSet([]) if obstacles is None else obstacles
    search = _SlabSearch(surface, max_excess_m, obstacles)
    boxes, rest = search.find_boxes(surface)
    pieces = surface.vertices[surface.triangles[rest]]
    if not len(pieces):
        return boxes
    groups = search.merge(search.divide([pieces], search.build_slab), search.build_slab)
    slabs = [search.build_slab(one) for one in groups]
    return boxes + _finish_parts(slabs, np.concatenate(groups), surface, max_excess_m, obstacles)


class _SlabSearch:
    """Search for groups of triangles whose hulls are close to a surface.

    Parameters
    ----------
    surface : the complete surface.
    obstacles : parts that hulls must not touch.
    """

    def __init__(self, surface: Mesh, max_excess_m: float, obstacles: PartSet) -> None:
        self._distance = SolidDistance(surface, is_solid=False)
        self._max_excess_m = max_excess_m
        self._obstacles = obstacles

    def build_slab(self, pieces: Floats) -> ConvexPart:
        """Return the hull of pieces and copies behind them, or in front if there is an obstacle behind.

        Folds have their back on either side.
        """
        depth = _BACKING_RATIO * self._max_excess_m
        slab = build_part(_back_pieces(pieces, depth))
        if self._obstacles.is_clear(slab):
            return slab
        turned = build_part(_back_pieces(pieces, -depth))
        return turned if self._obstacles.is_clear(turned) else slab

    def find_boxes(self, surface: Mesh) -> tuple[list[ConvexPart], NDArray[np.bool_]]:
        """Return boxes on large planar patches, and a mask of the other triangles."""
        max_shape = min(_PATCH_RATIO * self._max_excess_m, _MAX_PATCH_RATIO * self._distance.diagonal_m)
        patches = planar_patches(Mesh(surface.vertices, surface.triangles), max_shape=max_shape)
        rest = np.ones(len(surface.triangles), bool)
        boxes: list[ConvexPart] = []
        for row in np.flatnonzero(patches.areas >= (_MIN_PATCH_SIDES * self._max_excess_m) ** 2).tolist():
            own = patches.triangle_patch == row
            pieces = surface.vertices[surface.triangles[own]]
            axes = fit_rectangle(pieces.reshape(-1, 3), patches.normals[row])

            def build(part: Floats, axes: Floats = axes) -> ConvexPart:
                return build_box(part.reshape(-1, 3), axes, _BACKING_RATIO * self._max_excess_m)

            groups = self.merge(self.divide([pieces], build, axes[:2]), build)
            boxes += [build(one) for one in groups]
            rest &= ~own
        return boxes, rest

    def divide(self, pending: list[Floats], build: _Builder, axes: Floats | None = None) -> list[Floats]:
        """Halve groups of pieces until each hull is accepted, or small: an obstacle can be on the surface."""
        done: list[Floats] = []
        while pending:
            accepted = self._accept([build(one) for one in pending])
            divided: list[Floats] = []
            for pieces, is_accepted in zip(pending, accepted, strict=True):
                corners = pieces.reshape(-1, 3)
                if is_accepted or measure_diagonal(corners) <= _MIN_GROUP_RATIO * self._max_excess_m:
                    done.append(pieces)
                else:
                    divided += _divide_pieces(pieces, axes)
            pending = divided
        return done

    def merge(self, groups: list[Floats], build: _Builder) -> list[Floats]:
        """Merge neighbouring groups of pieces whose common hull is accepted, nearest pairs first."""
        is_new = np.ones(len(groups), bool)
        while is_new.any():
            pairs = _pair_neighbours(groups, is_new)
            merged = [np.concatenate((groups[i], groups[j])) for i, j in pairs]
            if not merged:
                break
            accepted = self._accept([build(one) for one in merged])
            used = {
                index
                for pair, is_accepted in zip(pairs, accepted, strict=True)
                if is_accepted
                for index in pair
            }
            kept = [one for index, one in enumerate(groups) if index not in used]
            made = [one for one, is_accepted in zip(merged, accepted, strict=True) if is_accepted]
            groups = kept + made
            is_new = np.arange(len(groups)) >= len(kept)
        return groups

    def _accept(self, hulls: Sequence[ConvexPart]) -> list[bool]:
        limit = _HULL_RATIO * self._max_excess_m
        is_close = is_within_excess(self._distance, hulls, limit).tolist()
        return [one and self._obstacles.is_clear(hull) for one, hull in zip(is_close, hulls, strict=True)]


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
        for preprocessing in _PREPROCESSING:
            try:
                run_reader_subprocess(
                    "scanloom.stages.exporting.simulation.coacd_process",
                    [str(source), str(target), repr(concavity_m), preprocessing],
                    _MAX_CPU_SECONDS,
                )
                break
            except SubprocessDiedError as error:
                if preprocessing != _PREPROCESSING[-1]:
                    continue
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


def _divide_pieces(pieces: Floats, axes: Floats | None = None) -> list[Floats]:
    """Divide pieces in two halves along their longest axis; long pieces are bisected first.

    Parameters
    ----------
    axes : (k, 3) directions to choose from; None for the principal axis.
    """
    centers = pieces.mean(axis=1)
    corners = pieces.reshape(-1, 3)
    if axes is None:
        axis = np.linalg.eigh(np.cov((corners - corners.mean(axis=0)).T))[1][:, 2]
    else:
        axis = axes[np.ptp(corners @ axes.T, axis=0).argmax()]
    extent = np.ptp(corners @ axis)
    is_long = np.ptp(pieces @ axis, axis=1) > extent / 2
    if is_long.any():
        pieces = np.concatenate((pieces[~is_long], bisect_triangles(pieces[is_long])))
        centers = pieces.mean(axis=1)
    along = centers @ axis
    middle = ((corners @ axis).min() + (corners @ axis).max()) / 2
    is_low = along <= middle
    return [half for half in (pieces[is_low], pieces[~is_low]) if len(half)]


def _finish_parts(
    parts: list[ConvexPart],
    pieces: Floats,
    surface: Mesh,
    max_excess_m: float,
    obstacles: PartSet,
) -> list[ConvexPart]:
    """Grow parts to contain pieces of the surface, and reduce their corners.

    A part that would touch an obstacle after the reduction keeps its corners.
    """
    step = compute_grid_step(surface)
    finished: list[ConvexPart] = []
    for part in _cover_surface(parts, pieces, max_excess_m):
        reduced = list(_reduce_corners(part, max_excess_m, step, _MAX_HALVINGS))
        if all(map(obstacles.is_clear, reduced)) or not obstacles.is_clear(part):
            finished += reduced
        else:
            finished += limit_corners(part, _COVER_RATIO * max_excess_m)
    return finished


def limit_corners(part: ConvexPart, overlap_m: float) -> list[ConvexPart]:
    """Split a part until no part has more than MAX_CORNERS corners.

    The parts overlap, so that each small piece of the surface is inside one of them.
    """
    if len(part.vertices) <= MAX_CORNERS:
        return [part]
    return [one for half in split_part(part, overlap_m) for one in limit_corners(half, overlap_m)]


def compute_grid_step(surface: Mesh) -> float:
    """Return the step of written coordinates, a power of ten in metres."""
    return float(10.0 ** np.floor(np.log10(_GRID_RATIO * measure_diagonal(surface.vertices))))


def _cover_surface(parts: list[ConvexPart], pieces: Floats, max_excess_m: float) -> list[ConvexPart]:
    """Grow parts until each triangle, or each of its pieces, is inside one part.

    A triangle is bisected only where several parts together need to grow less than one part.
    """
    added: list[list[Floats]] = [[] for _ in parts]
    tolerance = _COVER_RATIO * max_excess_m
    while len(pieces):
        growth, chosen, least = _find_nearest_parts(pieces, parts, max_excess_m)
        is_assigned = (growth <= least + tolerance) | (measure_longest_sides(pieces) <= tolerance)
        for index in np.unique(chosen[is_assigned & (growth > 0)]).tolist():
            added[index].append(pieces[is_assigned & (growth > 0) & (chosen == index)].reshape(-1, 3))
        pieces = bisect_triangles(pieces[~is_assigned])
    return [
        build_part(np.concatenate((part.vertices, *more))) if more else part
        for part, more in zip(parts, added, strict=True)
    ]


def _find_nearest_parts(
    pieces: Floats, parts: Sequence[ConvexPart], reach_m: float
) -> tuple[Floats, NDArray[np.int64], Floats]:
    """Find the part of each triangle that must grow least to contain it.

    Parts farther than `reach_m` are only compared if no other is nearer.

    Returns
    -------
    growth : (n,) height of the triangle above the planes of that part; 0 for a triangle inside.
    chosen : (n,) that part.
    least : (n,) lower bound of the growth for the pieces of the triangle together: the largest height of a
        corner above its own nearest part.
    """
    growth = np.full(len(pieces), np.inf)
    chosen = np.zeros(len(pieces), np.int64)
    of_corner = np.full((len(pieces), 3), np.inf)
    low, high = pieces.min(axis=1), pieces.max(axis=1)
    for reach in (reach_m, np.inf):
        missing = growth == np.inf
        if not missing.any():
            break
        for index, part in enumerate(parts):
            bottom, top = part.vertices.min(axis=0) - reach, part.vertices.max(axis=0) + reach
            rows = np.flatnonzero(missing & ((high >= bottom) & (low <= top)).all(axis=1))
            heights = part.compute_heights(pieces[rows].reshape(-1, 3)).reshape(-1, 3)
            heights[heights <= part.slack_m] = 0
            of_corner[rows] = np.minimum(of_corner[rows], heights)
            highest = heights.max(axis=1, initial=0)
            is_near = ((low[rows] >= bottom) & (high[rows] <= top)).all(axis=1)
            closer = is_near & (highest < growth[rows])
            growth[rows[closer]], chosen[rows[closer]] = highest[closer], index
    # A corner outside of all boxes has an unknown height.
    return growth, chosen, np.where(np.isfinite(of_corner), of_corner, 0.0).max(axis=1)


def _reduce_corners(
    part: ConvexPart, max_excess_m: float, step_m: float, halvings: int
) -> Iterator[ConvexPart]:
    """Yield parts with at most MAX_CORNERS corners on a grid, whose union contains the part.

    The hull of a few corners is scaled until it contains all. A part that would grow too much is halved.
    """
    max_growth = _MAX_CORNER_RATIO * max_excess_m
    center = part.vertices.mean(axis=0)
    reduced, scale = choose_corners(part, center, _CORNER_RATIO * max_excess_m)
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


def choose_corners(part: ConvexPart, center: Floats, max_growth_m: float) -> tuple[ConvexPart, float]:
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
    # The default tolerance takes rounding errors of four coplanar points for a volume.
    tolerance = 1e-9 * float(np.ptp(points, axis=0).max())
    while len(chosen) < 4 or np.linalg.matrix_rank(points[chosen] - points[chosen[0]], tolerance) < 3:
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
