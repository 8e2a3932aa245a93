"""Proof that convex parts contain a surface and exceed it by at most a bound.

Both bounds hold at every point, not only at samples: pieces of the surface and of the parts are bounded as a
whole, and bisected where the bound is loose.

Gap: distance from a point of the surface to the union of the parts. Distance to a convex part is a convex
function, so its maximum over a triangle is at a corner.

Excess: distance from a point of the parts to the solid that the surface encloses, or to the surface itself
if it is open. Distance changes by at most the length of a step, so the distance at the centre of a
tetrahedron bounds the distance at all its points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages._open3d import import_open3d
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, concatenate_faces
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_triangle_normals

Floats = NDArray[np.float64]

# A bound this close to the largest distance found is not tightened.
_TOLERANCE_RATIO = 1.05
# Default resolution of the excess, as a ratio of the bounding-box diagonal.
_RESOLUTION_RATIO = 5e-3
# Triangle pieces shorter than this ratio of the diagonal are not bisected.
_MIN_PIECE_RATIO = 1e-4
# Cells that are bisected at a time, 100 bytes each. The cells with the smallest bounds are set aside first.
_MAX_CELLS = 1 << 20
_MAX_LEVELS = 60
# Coordinates of ray casting have single precision, so that the side of nearer points is unknown.
_SLACK_RATIO = 1e-6
INSIDE, OUTSIDE, UNCLEAR = -1, 1, 0
# Oblique to the axes, along which scans have edges. Two rays do not meet an edge at the same point.
_RAYS = np.array([(0.5234, 0.6127, 0.5922), (-0.7741, 0.3319, -0.5391)])
_PAIRS = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])


@dataclass(frozen=True, eq=False)
class CollisionProof:
    """Proven bounds between a surface and convex parts.

    Attributes
    ----------
    gap_m : no point of the surface is farther outside the union of the parts.
    excess_m : no point of a part is farther from the solid, or from an open surface.
    attained_gap_m, attained_excess_m : largest distances found at a point. The true maximum is between the
        attained value and the bound.
    part_excess_m : (p,) bound of each part.
    pieces : number of surface pieces and cells that were evaluated.
    """

    gap_m: float
    excess_m: float
    attained_gap_m: float
    attained_excess_m: float
    part_excess_m: Floats
    pieces: int

    def to_dict(self) -> dict[str, Any]:
        """Return the overall bounds as JSON-compatible values."""
        return {
            "gap_bound_m": self.gap_m,
            "gap_attained_m": self.attained_gap_m,
            "excess_bound_m": self.excess_m,
            "excess_attained_m": self.attained_excess_m,
            "pieces": self.pieces,
        }


def prove_collision(
    surface: Mesh, parts: Sequence[ConvexPart], is_solid: bool, resolution_m: float | None = None
) -> CollisionProof:
    """Bound the gap and the excess of convex parts.

    Parameters
    ----------
    surface : mesh without duplicate vertices; closed and oriented if `is_solid`.
    is_solid : points enclosed by the surface belong to the object.
    resolution_m : bounds of the excess below this length are not tightened. None: 0.5 % of the diagonal.
    """
    gap, attained_gap, gap_pieces = _bound_gap(surface, parts)
    solid = SolidDistance(surface, is_solid)
    resolution_m = _RESOLUTION_RATIO * solid.diagonal_m if resolution_m is None else resolution_m
    part_excess, attained_excess, cells = _bound_excess(solid, parts, resolution_m)
    return CollisionProof(
        gap_m=gap,
        excess_m=float(part_excess.max(initial=0.0)),
        attained_gap_m=attained_gap,
        attained_excess_m=float(attained_excess.max(initial=0.0)),
        part_excess_m=part_excess,
        pieces=gap_pieces + cells,
    )


def prove_inside(surface: Mesh, parts: Sequence[ConvexPart]) -> CollisionProof:
    """Bound the gap of convex parts that `carve_parts` has proven to be inside a surface."""
    gap, attained, pieces = _bound_gap(surface, parts)
    return CollisionProof(gap, 0.0, attained, 0.0, np.zeros(len(parts)), pieces)


def measure_diagonal(points: Floats) -> float:
    """Return the length of the bounding-box diagonal of points."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def measure_longest_sides(pieces: Floats) -> Floats:
    """Return the length (n,) of the longest side of triangles (n, 3, 3)."""
    return np.asarray(np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2).max(axis=1))


def _is_covered(pieces: Floats, parts: Sequence[ConvexPart]) -> NDArray[np.bool_]:
    """Return a mask of the triangles that a single part contains."""
    covered = np.zeros(len(pieces), bool)
    low, high = pieces.min(axis=1), pieces.max(axis=1)
    for part in parts:
        slack = part.slack_m
        bottom, top = part.vertices.min(axis=0) - slack, part.vertices.max(axis=0) + slack
        near = np.flatnonzero(~covered & ((low >= bottom) & (high <= top)).all(axis=1))
        covered[near] = part.contains(pieces[near].reshape(-1, 3)).reshape(-1, 3).all(axis=1)
    return covered


def bisect_triangles(pieces: Floats) -> Floats:
    """Halve triangles at their longest side; both halves follow each other."""
    if not len(pieces):
        return pieces
    sides = np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2)
    order = (sides.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(pieces, order[..., None], axis=1).transpose(1, 0, 2)
    middle = (a + b) / 2
    halves = np.stack((np.stack((a, middle, c), axis=1), np.stack((middle, b, c), axis=1)), axis=1)
    return halves.reshape(-1, 3, 3)


def _bound_gap(surface: Mesh, parts: Sequence[ConvexPart]) -> tuple[float, float, int]:
    """Return the bound of the gap, the largest gap found, and the number of pieces."""
    pieces = surface.vertices[surface.triangles]
    slack = max(part.slack_m for part in parts)
    min_length = _MIN_PIECE_RATIO * measure_diagonal(surface.vertices)
    vertices, triangles, owner = concatenate_faces(parts)
    union = _kernels.NearestSurface(vertices, triangles, wanted_threads=0)
    bound = attained = 0.0
    count = 0
    while len(pieces):
        count += len(pieces)
        pieces = pieces[~_is_covered(pieces, parts)]
        if not len(pieces):
            break
        corners = pieces.reshape(-1, 3)
        is_outside = np.ones(len(corners), bool)
        for part in parts:
            is_outside[is_outside] = ~part.contains(corners[is_outside])
        distances = union.find_nearest(corners, wanted_threads=0)[2]
        attained = max(attained, float(distances[is_outside].max(initial=0.0)))
        # Distance of all corners to the part that is nearest to the centre.
        chosen = owner[union.find_nearest(pieces.mean(axis=1), wanted_threads=0)[0]]
        to_part = _measure_distances(pieces, chosen, parts)
        is_done = (to_part <= _TOLERANCE_RATIO * attained) | (measure_longest_sides(pieces) < min_length)
        bound = max(bound, float(to_part[is_done].max(initial=0.0)))
        pieces = bisect_triangles(pieces[~is_done])
    return (bound + slack if bound > 0 else 0.0), attained, count


def _measure_distances(pieces: Floats, chosen: NDArray[np.int64], parts: Sequence[ConvexPart]) -> Floats:
    """Return the largest distance (n,) of the corners of triangles to their chosen parts."""
    found = np.zeros(len(pieces))
    for index in np.unique(chosen):
        part, rows = parts[index], np.flatnonzero(chosen == index)
        corners = pieces[rows].reshape(-1, 3)
        faces = _kernels.NearestSurface(part.vertices, part.triangles, wanted_threads=1)
        distances = faces.find_nearest(corners, wanted_threads=0)[2]
        distances[part.contains(corners)] = 0
        found[rows] = distances.reshape(-1, 3).max(axis=1)
    return found


class SolidDistance:
    """Distance to a solid or an open surface, with the side of each point.

    A point is enclosed if the surface winds around it: along a ray, more triangles are left than entered.
    Unlike the side of the nearest triangle, this is right for surfaces that intersect themselves.

    Parameters
    ----------
    surface : mesh without duplicate vertices; closed and oriented if `is_solid`.

    Attributes
    ----------
    corners : (m, 3, 3) triangles of the surface.
    diagonal_m : length of the bounding-box diagonal.
    """

    def __init__(self, surface: Mesh, is_solid: bool) -> None:
        self.corners = surface.vertices[surface.triangles]
        self.diagonal_m = measure_diagonal(surface.vertices)
        self._surface = _kernels.NearestSurface(surface.vertices, surface.triangles, wanted_threads=0)
        self._is_solid = is_solid
        if not is_solid:
            return
        self._center = surface.vertices.mean(axis=0)
        o3d = import_open3d()
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(self._normalize(surface.vertices)),
            o3d.core.Tensor(surface.triangles.astype(np.uint32)),
        )
        normals = compute_triangle_normals(surface)
        self._signs = np.sign(normals @ _RAYS.T).astype(np.int64)

    def measure(self, points: Floats) -> tuple[Floats, NDArray[np.int8], NDArray[np.int32]]:
        """Measure the distance of points to the surface.

        Returns
        -------
        distances : (n,) to the surface.
        sides : (n,) INSIDE, OUTSIDE, or UNCLEAR where a ray hits an edge.
        triangles : (n,) nearest triangles.
        """
        triangles, _, distances = self._surface.find_nearest(points, wanted_threads=0)
        sides = np.full(len(points), OUTSIDE, np.int8)
        if self._is_solid:
            windings = [self._count_windings(points, ray) for ray in range(len(_RAYS))]
            is_inside = np.array([one > 0 for one in windings])
            sides[is_inside.any(axis=0)] = UNCLEAR
            sides[is_inside.all(axis=0)] = INSIDE
        return distances, sides, triangles

    def measure_excess(self, points: Floats) -> Floats:
        """Return the distances (n,) from the solid; 0 for points that are not outside."""
        distances, sides, _ = self.measure(points)
        return np.where(sides == OUTSIDE, distances, 0.0)

    def _count_windings(self, points: Floats, ray: int) -> NDArray[np.int64]:
        rays = np.empty((len(points), 6), np.float32)
        rays[:, :3] = self._normalize(points)
        rays[:, 3:] = _RAYS[ray]
        hits = self._scene.list_intersections(import_open3d().core.Tensor(rays))
        signs = self._signs[hits["primitive_ids"].numpy().astype(np.int64), ray]
        owners = hits["ray_ids"].numpy().astype(np.int64)
        return np.bincount(owners, signs, minlength=len(points)).astype(np.int64)

    def _normalize(self, points: Floats) -> NDArray[np.float32]:
        return np.asarray((points - self._center) / self.diagonal_m, np.float32)


def is_within_excess(solid: SolidDistance, parts: Sequence[ConvexPart], limit_m: float) -> NDArray[np.bool_]:
    """Return a mask (p,) of the parts whose excess is proven to be within a limit."""
    return np.asarray(_bound_excess(solid, parts, limit_m, limit_m)[0] <= limit_m)


def _bound_excess(
    solid: SolidDistance, parts: Sequence[ConvexPart], resolution_m: float, limit_m: float = np.inf
) -> tuple[Floats, Floats, int]:
    """Return the bound (p,) and the largest excess found (p,) of each part, and the number of cells.

    The bounds of parts that are found to exceed the limit are not tightened.
    """
    corner_owner = np.repeat(np.arange(len(parts)), [len(part.vertices) for part in parts])
    attained, bounds = np.zeros(len(parts)), np.zeros(len(parts))
    np.maximum.at(
        attained, corner_owner, solid.measure_excess(np.concatenate([part.vertices for part in parts]))
    )
    slack = _SLACK_RATIO * solid.diagonal_m
    cells = np.concatenate([_divide_part(part) for part in parts])
    owner = np.repeat(np.arange(len(parts)), [len(part.triangles) for part in parts])
    count = 0
    for level in range(_MAX_LEVELS):
        count += len(cells)
        goal = np.maximum(_TOLERANCE_RATIO * attained, resolution_m - slack)
        found, cell_bounds = _bound_cells(cells, solid, goal[owner])
        np.maximum.at(attained, owner, found)
        goal = np.maximum(_TOLERANCE_RATIO * attained, goal)
        goal[attained > limit_m] = np.inf
        is_done = cell_bounds <= goal[owner]
        if level == _MAX_LEVELS - 1:
            is_done[:] = True
        elif np.count_nonzero(~is_done) > _MAX_CELLS // 2:
            is_done[np.argsort(cell_bounds, kind="stable")[: len(cells) - _MAX_CELLS // 2]] = True
        np.maximum.at(bounds, owner[is_done], cell_bounds[is_done])
        if is_done.all():
            break
        cells, owner = _bisect_cells(cells[~is_done]), np.repeat(owner[~is_done], 2)
    return bounds + slack, attained, count


def _divide_part(part: ConvexPart) -> Floats:
    """Divide a part into tetrahedra (f, 4, 3) between its centre and its faces."""
    corners = part.vertices[part.triangles]
    center = np.broadcast_to(part.vertices.mean(axis=0), (len(corners), 1, 3))
    return np.concatenate((center, corners), axis=1)


def _bound_cells(cells: Floats, solid: SolidDistance, goal: Floats) -> tuple[Floats, Floats]:
    """Return the excess at the centre (n,) and the bound (n,) of each cell, tightened only above `goal`."""
    centers = cells.mean(axis=1)
    radii = np.linalg.norm(cells - centers[:, None], axis=2).max(axis=1)
    distances, sides, triangles = solid.measure(centers)
    # A point outside is on the far side of the surface, seen from a centre inside.
    bounds = np.where(sides == INSIDE, np.maximum(radii - distances, 0), radii + distances)
    # Distance to one triangle is convex, so its maximum over a cell is at a corner.
    loose = np.flatnonzero(bounds > goal)
    corners = solid.corners[triangles[loose]]
    to_triangle = np.zeros(len(loose))
    for k in range(4):
        np.maximum(to_triangle, _measure_to_triangles(cells[loose, k], corners), out=to_triangle)
    bounds[loose] = np.minimum(bounds[loose], to_triangle)
    return np.where(sides == OUTSIDE, distances, 0.0), bounds


def _measure_to_triangles(points: Floats, corners: Floats) -> Floats:
    """Return an upper bound of the distance (n,) of points to triangles (n, 3, 3)."""
    a, b, c = corners.transpose(1, 0, 2)
    # The nearest corner or the foot of the perpendicular, if it is inside the triangle.
    nearest = np.linalg.norm(points[:, None] - corners, axis=2).min(axis=1)
    first, second, offset = b - a, c - a, points - a
    normal = np.cross(first, second)
    area_squared = np.einsum("nx,nx->n", normal, normal)
    beta = np.einsum("nx,nx->n", np.cross(offset, second), normal)
    gamma = np.einsum("nx,nx->n", np.cross(first, offset), normal)
    is_above = (area_squared > 0) & (beta >= 0) & (gamma >= 0) & (beta + gamma <= area_squared)
    heights = np.abs(np.einsum("nx,nx->n", offset, normal))
    height = np.divide(heights, np.sqrt(area_squared), out=nearest.copy(), where=is_above)
    return np.asarray(np.minimum(nearest, height))


def _bisect_cells(cells: Floats) -> Floats:
    """Halve tetrahedra at their longest edge; both halves follow each other."""
    lengths = np.linalg.norm(cells[:, _PAIRS[:, 0]] - cells[:, _PAIRS[:, 1]], axis=2)
    first, second = _PAIRS[lengths.argmax(axis=1)].T
    rows = np.arange(len(cells))
    middle = (cells[rows, first] + cells[rows, second]) / 2
    halves = np.repeat(cells, 2, axis=0)
    halves[2 * rows, first] = middle
    halves[2 * rows + 1, second] = middle
    return halves
