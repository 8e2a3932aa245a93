"""Convex parts inside a solid, for collision geometry that is never larger than the visual mesh.

A convex part is carved until no triangle of the surface crosses it: a face moves inwards, or the plane of the
triangle cuts the part. A part without crossing triangles is completely inside or outside, so one point
decides.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.exporting.simulation.collision_proof import (
    INSIDE,
    SolidDistance,
    bisect_triangles,
    measure_longest_sides,
)
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, cut_points, try_build_part
from scanloom.stages.exporting.simulation.decomposition import choose_corners, compute_grid_step
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_triangle_normals

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Cuts of a part; a part that needs more is dropped.
_MAX_CUTS = 200
# A triangle that would cut off more than this share of the permitted gap is bisected first, down to the
# second share.
_CUT_RATIO, _PIECE_RATIO = 0.25, 0.5
# Shorter pieces of triangles, as a ratio of the bounding-box diagonal, are not bisected to prove that a part
# is inside.
_MIN_PIECE_RATIO = 1e-4
# Rounding of half-space tests, as a ratio of the bounding-box diagonal.
_ROUNDING_RATIO = 1e-12


def carve_parts(parts: Iterable[ConvexPart], surface: Mesh, max_gap_m: float) -> list[ConvexPart]:
    """Carve convex parts until they are inside a closed surface; drop those that cannot be.

    Parameters
    ----------
    max_gap_m : wanted distance of the surface from the parts.
    """
    solid = SolidDistance(surface, is_solid=True)
    step = compute_grid_step(surface)
    slack = _ROUNDING_RATIO * solid.diagonal_m
    normals = compute_triangle_normals(surface)
    carved = []
    for part in parts:
        inner = _carve(part, solid.corners, normals, max_gap_m, slack)
        rounded = None if inner is None else _round_inwards(inner, step)
        if rounded is not None and is_inside(rounded, solid, normals, slack):
            carved.append(rounded)
    return carved


def is_inside(part: ConvexPart, solid: SolidDistance, normals: Floats, slack_m: float) -> bool:
    """Return True if no triangle crosses a part and its centre is inside, so that all of it is inside."""
    near = _find_near(part, solid.corners)
    pieces, normals = solid.corners[near], normals[near]
    while len(pieces):
        crossing = _find_crossing(part, pieces, normals, slack_m)
        pieces, normals = pieces[crossing], normals[crossing]
        if not len(pieces):
            break
        is_deep = part.compute_heights(pieces.mean(axis=1)) < -slack_m
        is_short = measure_longest_sides(pieces) < _MIN_PIECE_RATIO * solid.diagonal_m
        if (is_deep | is_short).any():
            return False
        pieces, normals = bisect_triangles(pieces), np.repeat(normals, 2, axis=0)
    return bool(solid.measure(part.vertices.mean(axis=0)[None])[1][0] == INSIDE)


def _carve(
    part: ConvexPart, corners: Floats, normals: Floats, max_gap_m: float, slack_m: float
) -> ConvexPart | None:
    near = _find_near(part, corners)
    pieces, normals = corners[near], normals[near]
    for _ in range(_MAX_CUTS):
        crossing = _find_crossing(part, pieces, normals, slack_m)
        pieces, normals = pieces[crossing], normals[crossing]
        if not len(pieces):
            return part
        # Depth by which each face must move, and by which the plane of the triangle cuts the part.
        depths = -(pieces @ part.planes[:, :3].T + part.planes[:, 3]).min(axis=1)
        face = depths.argmin(axis=1)
        face_cost = depths[np.arange(len(pieces)), face]
        offsets = np.einsum("nx,nx->n", normals, pieces[:, 0])
        own_cost = (part.vertices @ normals.T).max(axis=0) - offsets
        cost = np.minimum(face_cost, own_cost)
        is_large = (cost > _CUT_RATIO * max_gap_m) & (
            measure_longest_sides(pieces) > _PIECE_RATIO * max_gap_m
        )
        if is_large.any():
            pieces = np.concatenate([pieces[~is_large], bisect_triangles(pieces[is_large])])
            normals = np.concatenate([normals[~is_large], np.repeat(normals[is_large], 2, axis=0)])
            continue
        worst = int(cost.argmax())
        if own_cost[worst] <= face_cost[worst]:
            heights = part.vertices @ normals[worst] - offsets[worst]
        else:
            plane = part.planes[face[worst]]
            heights = part.vertices @ plane[:3] + plane[3] + face_cost[worst]
        cut = try_build_part(cut_points(part, heights + slack_m))
        if cut is None:
            return None
        part = cut
    return None


def _find_near(part: ConvexPart, corners: Floats) -> Mask:
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    return np.asarray(((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1))


def _find_crossing(part: ConvexPart, pieces: Floats, normals: Floats, slack_m: float) -> Mask:
    """Return a mask (n,) of triangles that no face plane and not their own plane separates from a part."""
    if not len(pieces):
        return np.zeros(0, bool)
    outside = ((pieces @ part.planes[:, :3].T + part.planes[:, 3]).min(axis=1) >= -slack_m).any(axis=1)
    heights = part.vertices @ normals.T - np.einsum("nx,nx->n", normals, pieces[:, 0])
    is_beside = (heights.max(axis=0) <= slack_m) | (heights.min(axis=0) >= -slack_m)
    return np.asarray(~(outside | is_beside))


def _round_inwards(part: ConvexPart, step_m: float) -> ConvexPart | None:
    """Reduce the corners of a part, and round them to the grid, without leaving the part."""
    center = part.vertices.mean(axis=0)
    reduced = choose_corners(part, center, 0.0)[0]
    depth = float(-(reduced.planes[:, :3] @ center + reduced.planes[:, 3]).max())
    if depth <= 2 * step_m:
        return None
    grid = np.rint((center + (reduced.vertices - center) * (1 - step_m / depth)) / step_m)
    return try_build_part(np.unique(grid, axis=0) / round(1 / step_m) if step_m < 1 else grid * step_m)
