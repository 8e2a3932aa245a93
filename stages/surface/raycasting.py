"""Closest-point and ray queries on a mesh with Open3D's ray-casting scene, in double precision.

Embree stores coordinates as float32, whose step at map coordinates of 500 km is 3 cm. The scene is therefore
centred and scaled to unit size, and only selects the triangle. The closest point and distance are then
computed on that triangle in float64. The remaining error: the selection is arbitrary between triangles whose
distances differ by less than about 1e-6 of the bounding-box diagonal.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.surface.mesh import Mesh, Triangles

Floats = NDArray[np.float64]

# Queries per call: limits memory, and keeps the arrays in cache.
CHUNK_SIZE = 1 << 17
# A triangle whose doubled area is below this ratio of its squared longest side is treated as that side.
_MAX_SLIVER_RATIO = 1e-4


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """Closest points on the surface.

    Attributes
    ----------
    triangles : (k,) int64, triangle index of each point.
    weights : (k, 3) float64 barycentric weights of the triangle's corners, non-negative, with sum 1.
    distances : (k,) float64, distance to the query point in metres.
    """

    triangles: NDArray[np.int64]
    weights: Floats
    distances: Floats


@dataclass(frozen=True, eq=False)
class RayHits:
    """First intersections of rays with the surface; float32, the precision of the ray caster.

    Attributes
    ----------
    rays : (k,) int64, indices of the rays that hit, ascending.
    triangles : (k,) int64, triangle hit by each ray.
    weights : (k, 3) float32 barycentric weights of the triangle's corners, non-negative, with sum 1.
    distances : (k,) float32, distance along the ray in lengths of its direction vector.
    normals : (k, 3) float32, unit normals of the triangles.
    """

    rays: NDArray[np.int64]
    triangles: NDArray[np.int64]
    weights: NDArray[np.float32]
    distances: NDArray[np.float32]
    normals: NDArray[np.float32]

    def __getitem__(self, chosen: NDArray[np.bool_]) -> RayHits:
        """Return the hits selected by a mask (k,)."""
        return RayHits(
            self.rays[chosen],
            self.triangles[chosen],
            self.weights[chosen],
            self.distances[chosen],
            self.normals[chosen],
        )


class Slimness(NamedTuple):
    """Longest side and area of triangles, to detect needles and slivers.

    Attributes
    ----------
    longest_side : (m,) int64, corner at which the longest side starts.
    longest_squared : (m,) squared length of the longest side, m².
    doubled_area : (m,) twice the area, m².
    """

    longest_side: NDArray[np.int64]
    longest_squared: Floats
    doubled_area: Floats


class RaycastingSurface:
    """A mesh prepared for closest-point and ray queries.

    Parameters
    ----------
    mesh : mesh with at least one triangle.
    box : (2, 3) minimum and maximum corner of mesh and query points; None for the mesh's bounding box. Far
        outside
        it, the selection of the triangle loses precision.

    Attributes
    ----------
    mesh : the mesh.
    slimness : longest side and area of its triangles.
    """

    def __init__(self, mesh: Mesh, box: Floats | None = None) -> None:
        box = compute_bounding_box(mesh) if box is None else box
        self.mesh = mesh
        self._center = box.mean(axis=0)
        self._scale = 1 / max(float(np.linalg.norm(box[1] - box[0])), np.finfo(np.float64).tiny)
        self.slimness = measure_slimness(mesh)
        o3d = import_open3d()
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(self._normalize_points(mesh.vertices)),
            o3d.core.Tensor(_replace_slivers(mesh, self.slimness).astype(np.uint32)),
        )
        # Open3D builds its BVH at the first query. Trigger that now, because it is not thread-safe.
        self._scene.compute_closest_points(o3d.core.Tensor(np.zeros((1, 3), np.float32)))

    def replace_mesh(self, mesh: Mesh) -> RaycastingSurface:
        """Return a copy with another mesh of equal geometry.

        The other mesh can have different colours.
        """
        other = copy.copy(self)
        other.mesh = mesh
        return other

    @cached_property
    def normals(self) -> Floats:
        """Unit normals (m, 3) of the triangles; 0 for triangles without area."""
        return compute_triangle_normals(self.mesh)

    def find_closest_points(self, points: Floats) -> ClosestPoints:
        """Find the closest surface point of each of `points`, (k, 3) float64 in metres."""
        parts = [self._find_closest_in_chunk(points[rows]) for rows in iterate_chunks(len(points))]
        return _concatenate_points(parts)

    def cast_rays(
        self,
        origin: Floats,
        directions: NDArray[np.floating],
        starts: NDArray[np.float32] | None = None,
    ) -> RayHits:
        """Find the first intersection of each ray.

        Parameters
        ----------
        origin : (3,) float64 in metres for all rays, or (k, 3).
        directions : (k, 3) of any length; distances are multiples of that length.
        starts : (k,) minimum distances; None for 0.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3] = self._normalize_points(
            origin if starts is None else origin + starts[:, None] * directions
        )
        rays[:, 3:] = directions
        found = self._scene.cast_rays(import_open3d().core.Tensor(rays))
        distances = found["t_hit"].numpy() / np.float32(self._scale)
        met = np.flatnonzero(np.isfinite(distances))
        if starts is not None:
            distances += starts
        u, v = found["primitive_uvs"].numpy().take(met, axis=0).T
        return RayHits(
            met,
            found["primitive_ids"].numpy().take(met).astype(np.int64),
            np.stack([1 - u - v, u, v], axis=1).clip(0, 1),
            distances.take(met),
            found["primitive_normals"].numpy().take(met, axis=0),
        )

    def are_occluded(
        self, origins: Floats, directions: NDArray[np.float32], max_distance: float
    ) -> NDArray[np.bool_]:
        """Check if rays hit the surface within a distance.

        Parameters
        ----------
        origins : (k, 3) metres.
        directions : (k, 3) unit vectors.
        max_distance : metres.
        """
        rays = np.concatenate([self._normalize_points(origins), directions], axis=1)
        limit = max_distance * self._scale
        return np.asarray(self._scene.test_occlusions(import_open3d().core.Tensor(rays), 0.0, limit).numpy())

    def find_nearest_triangles(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Find the triangle (k,) nearest to each point, and its distance, in single precision.

        Faster than `find_closest_points`. All points are queried in one call; there must be at least one.
        """
        asked = self._normalize_points(points)
        found = self._scene.compute_closest_points(import_open3d().core.Tensor(asked))
        away = found["points"].numpy() - asked
        distances = np.sqrt(np.einsum("kx,kx->k", away, away)) / np.float32(self._scale)
        return found["primitive_ids"].numpy().astype(np.int64), distances

    def _find_closest_in_chunk(self, points: Floats) -> ClosestPoints:
        found = self._scene.compute_closest_points(
            import_open3d().core.Tensor(self._normalize_points(points))
        )
        triangles = found["primitive_ids"].numpy().astype(np.int64)
        corners = self.mesh.vertices[self.mesh.triangles[triangles]]
        weights = compute_closest_weights(points, corners)
        nearest = np.einsum("kc,kcx->kx", weights, corners)
        return ClosestPoints(triangles, weights, np.linalg.norm(points - nearest, axis=1))

    def _normalize_points(self, points: Floats) -> NDArray[np.float32]:
        return np.asarray((points - self._center) * self._scale, np.float32)


def measure_slimness(mesh: Mesh) -> Slimness:
    """Compute the longest side and area of each triangle."""
    count = len(mesh.triangles)
    sides2, area2_squared = np.zeros((3, count)), np.zeros(count)
    first, second = np.empty((3, count)), np.empty((3, count))
    # One coordinate at a time is several times faster than rows of three.
    for axis in range(3):
        a, b, c = (mesh.vertices[:, axis].take(corner) for corner in mesh.triangles.T)
        first[axis], second[axis] = b - a, c - b
        for side, along in enumerate((first[axis], second[axis], a - c)):
            sides2[side] += along * along
    for i, j in ((1, 2), (2, 0), (0, 1)):
        across = first[i] * second[j] - first[j] * second[i]
        area2_squared += across * across
    longest = sides2.argmax(axis=0)
    return Slimness(longest, sides2.max(axis=0), np.sqrt(area2_squared))


def _replace_slivers(mesh: Mesh, slimness: Slimness) -> Triangles:
    """Replace every sliver by its longest side, as degenerate triangle (first, second, second).

    In single precision, the closest point of a sliver can be anywhere along its line, so another triangle
    could be selected. The closest point of a segment is stable.
    """
    (slivers,) = np.nonzero(slimness.doubled_area <= _MAX_SLIVER_RATIO * slimness.longest_squared)
    if not len(slivers):
        return mesh.triangles
    triangles: Triangles = mesh.triangles.copy()
    longest = slimness.longest_side[slivers]
    first, second = longest, (longest + 1) % 3
    triangles[slivers] = mesh.triangles[slivers[:, None], np.stack([first, second, second], axis=1)]
    return triangles


def compute_triangle_normals(mesh: Mesh) -> Floats:
    """Compute the unit normals (m, 3) of a mesh's triangles; 0 for triangles without area."""
    # One coordinate at a time is several times faster than rows of three.
    corners = np.array([[x.take(corner) for x in mesh.vertices.T] for corner in mesh.triangles.T])
    first, second = corners[1] - corners[0], corners[2] - corners[0]
    across = [first[i] * second[j] - first[j] * second[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    lengths = np.sqrt(sum(x * x for x in across))
    normals = np.zeros((len(mesh.triangles), 3))
    for axis in range(3):
        np.divide(across[axis], lengths, out=normals[:, axis], where=lengths > 0)
    return normals


def compute_bounding_box(*meshes: Mesh) -> Floats:
    """Return the bounding box of all triangles: minimum and maximum corner (2, 3)."""
    corners = [mesh.vertices.compress(mask_used_vertices(mesh), axis=0) for mesh in meshes]
    # One column at a time: a reduction over rows of three is several times slower.
    low = [min(points[:, axis].min() for points in corners) for axis in range(3)]
    high = [max(points[:, axis].max() for points in corners) for axis in range(3)]
    return np.array([low, high])


def mask_used_vertices(mesh: Mesh) -> NDArray[np.bool_]:
    """Return a mask (n,) of the vertices used by triangles."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.triangles] = True
    return used


def iterate_chunks(count: int) -> Iterator[slice]:
    """Yield slices of at most CHUNK that cover `count` rows."""
    for start in range(0, count, CHUNK_SIZE):
        yield slice(start, min(start + CHUNK_SIZE, count))


def interpolate_values(values: NDArray[np.generic], mesh: Mesh, points: ClosestPoints) -> Floats:
    """Interpolate vertex values (n, d) at surface points; return (k, d) float64."""
    corners = values[mesh.triangles[points.triangles]].astype(np.float64)
    return np.asarray(np.einsum("kc,kcd->kd", points.weights, corners))


def compute_closest_weights(points: Floats, corners: Floats) -> Floats:
    """Compute barycentric weights (k, 3) of the closest point on each triangle.

    `corners` is (k, 3, 3). The closest point is the perpendicular foot if it is inside, else the closest
    point on the three edges. A triangle without area has only its edges.
    """
    a = corners[:, 0]
    ab, ac, ap = corners[:, 1] - a, corners[:, 2] - a, points - a
    # Cross products instead of normal equations, which would square the condition number; slivers are common.
    normal = np.cross(ab, ac)
    squared = _dot(normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = _dot(np.cross(ap, ac), normal) / squared
        w = _dot(np.cross(ab, ap), normal) / squared
    weights = np.stack([1 - v - w, v, w], axis=1)
    outside = np.flatnonzero(~((weights >= 0).all(axis=1) & (squared > 0)))
    weights[outside] = _find_closest_on_edges(points[outside], corners[outside])
    return weights


def _find_closest_on_edges(points: Floats, corners: Floats) -> Floats:
    best = np.full(len(points), np.inf)
    weights = np.zeros((len(points), 3))
    for start, end in ((0, 1), (1, 2), (2, 0)):
        edge, offset = corners[:, end] - corners[:, start], points - corners[:, start]
        length_squared = _dot(edge, edge)
        along = np.divide(
            _dot(offset, edge), length_squared, out=np.zeros(len(points)), where=length_squared > 0
        )
        along = along.clip(0, 1)
        gap = offset - along[:, None] * edge
        distance = _dot(gap, gap)
        closer = np.flatnonzero(distance < best)
        best[closer] = distance[closer]
        weights[closer] = 0
        weights[closer, start] = 1 - along[closer]
        weights[closer, end] = along[closer]
    return weights


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("kx,kx->k", a, b))


def _concatenate_points(parts: list[ClosestPoints]) -> ClosestPoints:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return ClosestPoints(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))
    return ClosestPoints(
        np.concatenate([p.triangles for p in parts]),
        np.concatenate([p.weights for p in parts]),
        np.concatenate([p.distances for p in parts]),
    )
