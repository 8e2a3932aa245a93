"""Thickening of thin walls: the union of a solid with balls whose diameter is the minimum thickness.

A ray into a union of balls of diameter t, along the normal of its surface, passes through the centre of a
ball, so that the wall is at least t thick there. Each thin point of the surface gets the ball that contains
the point and extends least out of the solid. All surface outside of the balls stays exactly.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.solids.booleans import from_manifold, to_manifold
from scanloom.stages.cleaning.solids.level_set import WindingNumbers, extract_boundary, list_cells
from scanloom.stages.cleaning.solids.self_intersections import refill
from scanloom.stages.cleaning.solids.shell import Shell, compute_volumes
from scanloom.stages.cleaning.thickness import measure_thickness, measure_thickness_at
from scanloom.stages.surface.edges import Ids, build_edges, label_components
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.welding import find_first_equal_rows

# Radius of the balls as a ratio of half the thickness: their surface is a mesh with chords.
_RADIUS_RATIO = 1.1
# Lengths as ratios of half the thickness: distance of samples, edge of grid cells, and distance between a
# sample and the centre of its ball.
_SAMPLE_RATIO, _CELL_RATIO, _CENTER_RATIO = 0.25, 0.8, 0.98
# Samples and centres in the same cell of this size, as a ratio of half the thickness, count as one.
_MERGE_RATIO = 0.125
# Centres move by up to a quarter of half the thickness per step, and each failed step halves the next one.
_CENTER_STEPS = 16
# Steps that make the triangles of the balls regular.
_RELAXING_STEPS = 4
# Maximum rounds of adding balls: to the balls alone, and to the solid. Centres are inside of the given solid
# in the first rounds. Later rounds also fill narrow gaps next to it.
_MAX_BALL_ROUNDS, _MAX_ROUNDS, _INNER_ROUNDS = 8, 8, 2
# Maximum number of samples: several minutes and a few GB.
_MAX_SAMPLES = 4_000_000
# Rounding of thickness and of files in single precision, as a ratio of the surface's diagonal.
_TOLERANCE_RATIO = 2e-6


@dataclass(frozen=True, eq=False)
class ThickenedShell:
    """A solid with thicker walls.

    Attributes
    ----------
    shell : the solid; `source` is the triangle of the solid before.
    nearest_triangle : (n,) triangle of the solid before that is nearest to each vertex of added surface; -1
        for other vertices.
    max_distance_m : maximum distance of vertices of added surface from the surface before.
    """

    shell: Shell
    nearest_triangle: Ids
    max_distance_m: float


def thicken(shell: Shell, thickness: float, edge_length: float) -> ThickenedShell | None:
    """Add material where a solid is thinner than a limit; return None if that takes too many balls.

    Walls can stay thinner at single triangles. The surface can intersect itself at single triangles.

    Parameters
    ----------
    shell : solid without self-intersections.
    thickness : minimum length of a ray through the solid, from a triangle's centre along its inward normal.
    edge_length : edge length of holes that are refilled to remove self-intersections, metres.
    """
    extent = float(np.linalg.norm(np.ptp(shell.vertices, axis=0)))
    limit = thickness + _TOLERANCE_RATIO * extent
    found = Shell(shell.vertices, shell.triangles, np.arange(len(shell.triangles)))
    solid = _Solid(shell.mesh)
    for number in range(_MAX_ROUNDS):
        centers = _find_centers(found, limit) if number == 0 else _find_ray_centers(found.mesh, limit)
        if centers is None:
            return None
        if len(centers) == 0:
            break
        balls = to_manifold(_make_balls(centers, limit, solid if number < _INNER_ROUNDS else None))
        united = _drop_small_cavities(from_manifold(to_manifold(found) + balls), thickness)
        found = refill(united, edge_length) or united
    is_new = np.zeros(len(found.vertices), bool)
    is_new[found.triangles[found.source < 0]] = True
    is_new[found.triangles[found.source >= 0]] = False
    nearest = np.full(len(found.vertices), -1)
    closest = RaycastingSurface(shell.mesh).find_closest_points(found.vertices[is_new])
    nearest[is_new] = closest.triangles
    return ThickenedShell(found, nearest, float(closest.distances.max(initial=0.0)))


def _find_centers(shell: Shell, limit: float) -> Vertices | None:
    """Return the centres of balls that contain all thin points of a surface; None if they are too many."""
    mesh, half = shell.mesh, limit / 2
    surface = RaycastingSurface(mesh)
    welded = find_first_equal_rows(list(mesh.vertices.T))[mesh.triangles]
    front: NDArray[np.bool_] = measure_thickness(mesh) < limit
    tested = np.zeros(len(front), bool)
    points, centers = [np.zeros((0, 3))], [np.zeros((0, 3))]
    # Large triangles can be thin although their centres are not. They are next to thin ones.
    while front.any():
        touched = np.zeros(len(mesh.vertices), bool)
        touched[welded[front]] = True
        rows = np.flatnonzero(touched[welded].any(axis=1) & ~tested)
        if _count_samples(mesh, rows, half) + sum(map(len, points)) > _MAX_SAMPLES:
            return None
        tested[rows] = True
        samples, owner = _sample_triangles(mesh, rows, _SAMPLE_RATIO * half)
        normals = surface.normals[owner]
        depths = measure_thickness_at(surface, samples, -normals)
        is_thin = depths < limit
        points.append(samples[is_thin])
        centers.append(samples[is_thin] - depths[is_thin, None] / 2 * normals[is_thin])
        front = np.zeros(len(front), bool)
        front[owner[is_thin]] = True
    samples, middles = np.concatenate(points), np.concatenate(centers)
    kept = _select_distinct(samples, _MERGE_RATIO * half)
    deep = _deepen_centers(surface, samples[kept], middles[kept], half)
    return np.asarray(deep[_select_distinct(deep, _MERGE_RATIO * half)])


def _find_ray_centers(mesh: Mesh, limit: float) -> Vertices:
    """Return the centres of the rays (k, 3) through a solid that are shorter than a limit.

    Rounding to single precision, as in STL and glTF files, turns narrow triangles. Both are tested.
    """
    found = []
    for vertices in (mesh.vertices, mesh.vertices.astype(np.float32).astype(np.float64)):
        rounded = Mesh(vertices, mesh.triangles)
        depths = measure_thickness(rounded)
        (thin,) = np.nonzero(depths < limit)
        starts = vertices[mesh.triangles[thin]].mean(axis=1)
        found.append(starts - depths[thin, None] / 2 * RaycastingSurface(rounded).normals[thin])
    return np.concatenate(found)


class _Solid:
    """The solid without balls."""

    def __init__(self, mesh: Mesh) -> None:
        self._surface, self._winding = RaycastingSurface(mesh), WindingNumbers(mesh)

    def pull_inside(self, centers: Vertices) -> Vertices:
        """Move centres that are outside onto the surface, so that no ball extends far out of the solid."""
        (outer,) = np.nonzero(~self._winding.is_inside(centers))
        closest = self._surface.find_closest_points(centers[outer])
        mesh = self._surface.mesh
        corners = mesh.vertices[mesh.triangles[closest.triangles]]
        pulled = centers.copy()
        pulled[outer] = np.einsum("kc,kcx->kx", closest.weights, corners)
        return np.asarray(pulled)


def _count_sides(mesh: Mesh, rows: Ids, spacing: float) -> Ids:
    corners = mesh.vertices[mesh.triangles[rows]]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    return np.asarray(np.maximum(np.ceil(lengths / spacing), 1).astype(np.int64))


def _count_samples(mesh: Mesh, rows: Ids, half: float) -> int:
    return int((_count_sides(mesh, rows, _SAMPLE_RATIO * half).astype(float) ** 2).sum())


def _sample_triangles(mesh: Mesh, rows: Ids, spacing: float) -> tuple[Vertices, Ids]:
    """Return the centres of equal parts of triangles, and their triangles; `spacing` limits their edges."""
    sides = _count_sides(mesh, rows, spacing)
    points, owners = [np.zeros((0, 3))], [np.zeros(0, np.int64)]
    for count in np.unique(sides).tolist():
        i, j = (axis.reshape(-1) for axis in np.mgrid[:count, :count])
        upper, lower = i + j < count, i + j < count - 1
        b = np.concatenate([i[upper] + 1 / 3, i[lower] + 2 / 3]) / count
        c = np.concatenate([j[upper] + 1 / 3, j[lower] + 2 / 3]) / count
        own = rows[sides == count]
        corners = mesh.vertices[mesh.triangles[own]]
        points.append(np.einsum("kc,tcx->tkx", np.stack([1 - b - c, b, c], axis=1), corners).reshape(-1, 3))
        owners.append(np.repeat(own, len(b)))
    return np.concatenate(points), np.concatenate(owners)


def _select_distinct(points: Vertices, size: float) -> Ids:
    """Return the first point in each cell of a grid, ascending."""
    cells = np.floor(points / size).astype(np.int64)
    return np.asarray(np.sort(np.unique(cells, axis=0, return_index=True)[1]))


def _deepen_centers(
    surface: RaycastingSurface, samples: Vertices, centers: Vertices, half: float
) -> Vertices:
    """Move centres into the solid, without leaving a distance from their samples.

    A ball around a deeper centre extends less out of the solid.
    """
    reach = _CENTER_RATIO * half
    corners = surface.mesh.vertices[surface.mesh.triangles]

    def find_surface(points: Vertices) -> tuple[NDArray[np.float64], Vertices]:
        closest = surface.find_closest_points(points)
        return closest.distances, np.einsum("kc,kcx->kx", closest.weights, corners[closest.triangles])

    depths, feet = find_surface(centers)
    steps = np.full(len(centers), half / 4)
    tiny = np.finfo(float).tiny
    for _ in range(_CENTER_STEPS):
        moved = centers + (steps / np.maximum(depths, tiny))[:, None] * (centers - feet)
        offsets = moved - samples
        ratios = np.minimum(1, reach / np.maximum(np.linalg.norm(offsets, axis=1), tiny))
        moved = samples + ratios[:, None] * offsets
        moved_depths, moved_feet = find_surface(moved)
        # Smaller gains would move centres along the middle of a wall, so that the balls leave gaps.
        is_better = moved_depths > depths + 0.01 * half
        centers = np.where(is_better[:, None], moved, centers)
        depths = np.where(is_better, moved_depths, depths)
        feet = np.where(is_better[:, None], moved_feet, feet)
        steps = np.where(is_better, steps, steps / 2)
    return centers


def _make_balls(centers: Vertices, limit: float, solid: _Solid | None) -> Shell:
    """Return the surface of the union of balls, which is nowhere thinner than the limit if possible.

    Balls that hardly overlap have a thin neck between them. Balls are added there. All centres are moved into
    the solid, if given.
    """
    size = _CELL_RATIO * limit / 2
    radius = _RADIUS_RATIO * limit / 2
    added, centers = centers, np.zeros((0, 3))
    for _ in range(_MAX_BALL_ROUNDS):
        centers = np.concatenate([centers, added if solid is None else solid.pull_inside(added)])
        mesh = _extract_balls(centers, radius, size)
        added = _find_ray_centers(mesh, limit)
        if len(added) == 0:
            break
    return Shell(mesh.vertices, mesh.triangles, np.full(len(mesh.triangles), -1))


def _extract_balls(centers: Vertices, radius: float, size: float) -> Mesh:
    balls = _Balls(centers, radius)
    mesh = extract_boundary(balls, list_cells(centers, size, int(np.ceil(radius / size)) + 1), size)
    # Triangles of the grid can be arbitrarily narrow, with inexact normals.
    return mesh.with_(vertices=balls.relax(mesh.vertices, mesh.triangles))


class _Balls:
    """A union of balls."""

    def __init__(self, centers: Vertices, radius: float) -> None:
        from scipy.spatial import cKDTree

        self._centers, self._radius = centers, radius
        self._tree: Any = cKDTree(centers)

    def is_inside(self, points: Vertices) -> NDArray[np.bool_]:
        return np.asarray(self._find_nearest(points)[0] < self._radius)

    def find_crossings(self, inner: Vertices, outer: Vertices) -> NDArray[np.float64]:
        low, high = self._find_nearest(inner)[0], self._find_nearest(outer)[0]
        return np.asarray((self._radius - low) / np.maximum(high - low, np.finfo(float).tiny))

    def relax(self, vertices: Vertices, triangles: Triangles) -> Vertices:
        """Move vertices halfway to the mean of their neighbours, and back onto the surface."""
        ends = build_edges(triangles, len(vertices)).ends
        degrees = np.bincount(ends.reshape(-1), minlength=len(vertices))[:, None]
        for _ in range(_RELAXING_STEPS):
            sums = [
                np.bincount(ends[:, 0], column[ends[:, 1]], len(vertices))
                + np.bincount(ends[:, 1], column[ends[:, 0]], len(vertices))
                for column in vertices.T
            ]
            vertices = self._project((vertices + np.stack(sums, axis=1) / degrees) / 2)
        return self._project(vertices)

    def _project(self, points: Vertices) -> Vertices:
        distances, nearest = self._find_nearest(points)
        centers = self._centers[nearest]
        ratios = self._radius / np.maximum(distances, np.finfo(float).tiny)
        return np.asarray(centers + ratios[:, None] * (points - centers))

    def _find_nearest(self, points: Vertices) -> tuple[NDArray[np.float64], Ids]:
        distances, nearest = self._tree.query(points, workers=-1)
        return distances, nearest


def _drop_small_cavities(shell: Shell, thickness: float) -> Shell:
    """Fill cavities between balls and the solid that are too small to print."""
    count, labels = label_components(
        len(shell.vertices), shell.triangles[:, :2].reshape(-1), shell.triangles[:, 1:].reshape(-1)
    )
    component = labels[shell.triangles[:, 0]]
    volumes = np.bincount(
        component, compute_volumes(shell.vertices - shell.vertices.mean(axis=0), shell.triangles), count
    )
    is_new = np.bincount(component, shell.source < 0, count) > 0
    dropped = is_new & (volumes < 0) & (volumes > -(thickness**3))
    return shell.select(~dropped[component]) if dropped.any() else shell
