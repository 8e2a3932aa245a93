"""A mesh as Open3D's ray-casting scene, without the float32 trap.

Embree, underneath, holds coordinates as float32: at map coordinates of 500 km a step is 3 cm. So the scene
is centred and scaled to unit size first, it only *chooses* the triangle, and the closest point and its
distance are then computed on that triangle in float64. What is left is the choice between triangles whose
distances differ by less than about 1e-6 of the box's diagonal.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import open3d
from scanloom.stages.surface.mesh import Mesh, Triangles

Floats = NDArray[np.float64]

# Queries at a time: bounds the memory of any number of points, and keeps the arrays near the cache.
CHUNK = 1 << 17
# A triangle whose height is below this share of its longest side is as good as that side.
_SLIVER = 1e-4


@dataclass(frozen=True, eq=False)
class Located:
    """Points on the surface.

    Attributes
    ----------
    triangles : (k,) int64, the triangle each point lies on.
    weights : (k, 3) float64 barycentric weights of its three corners, non-negative, of sum 1.
    distances : (k,) float64, metres, from the query point.
    """

    triangles: NDArray[np.int64]
    weights: Floats
    distances: Floats


@dataclass(frozen=True, eq=False)
class Hits:
    """Where rays met the surface first; float32, which is as exact as the ray caster is.

    Attributes
    ----------
    rays : (k,) int64, the rays that met it, in ascending order.
    triangles : (k,) int64, the triangle each met.
    weights : (k, 3) float32 barycentric weights of its three corners, non-negative, of sum 1.
    distances : (k,) float32, along the ray, in lengths of its direction.
    normals : (k, 3) float32, unit normals of the triangles.
    """

    rays: NDArray[np.int64]
    triangles: NDArray[np.int64]
    weights: NDArray[np.float32]
    distances: NDArray[np.float32]
    normals: NDArray[np.float32]

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Hits:
        """Return the hits a mask (k,) chooses."""
        return Hits(
            self.rays[chosen],
            self.triangles[chosen],
            self.weights[chosen],
            self.distances[chosen],
            self.normals[chosen],
        )


class Slimness(NamedTuple):
    """What tells needles and slivers from other triangles.

    Attributes
    ----------
    longest : (m,) int64, the corner that the longest side starts at.
    longest2 : (m,) its length squared.
    area2 : (m,) twice the area.
    """

    longest: NDArray[np.int64]
    longest2: Floats
    area2: Floats


class Surface:
    """The surface of a mesh, ready for closest-point and ray queries.

    Parameters
    ----------
    mesh : with at least one triangle.
    box : (2, 3) lowest and highest corner of everything that will be asked; the mesh's own box if None.
        Queries far outside it lose precision in the choice of the triangle.

    Attributes
    ----------
    mesh : as given.
    slimness : of its triangles.
    """

    def __init__(self, mesh: Mesh, box: Floats | None = None) -> None:
        box = bounding_box(mesh) if box is None else box
        self.mesh = mesh
        self._center = box.mean(axis=0)
        self._scale = 1 / max(float(np.linalg.norm(box[1] - box[0])), np.finfo(np.float64).tiny)
        self.slimness = slimness_of(mesh)
        o3d = open3d()
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            o3d.core.Tensor(self._scaled(mesh.vertices)),
            o3d.core.Tensor(_without_slivers(mesh, self.slimness).astype(np.uint32)),
        )
        # Open3D builds its tree at the first query: have that now, before several threads ask.
        self._scene.compute_closest_points(o3d.core.Tensor(np.zeros((1, 3), np.float32)))

    def showing(self, mesh: Mesh) -> Surface:
        """Return the same surface with other colours: of a mesh of the same vertices and triangles."""
        other = copy.copy(self)
        other.mesh = mesh
        return other

    @cached_property
    def normals(self) -> Floats:
        """Unit normals (m, 3) of the triangles; 0 for those without area."""
        return unit_normals(self.mesh)

    def closest(self, points: Floats) -> Located:
        """Return the surface point nearest to each of `points`, (k, 3) float64 in metres."""
        parts = [self._closest(points[rows]) for rows in chunks(len(points))]
        return _joined(parts)

    def cast(
        self,
        origin: Floats,
        directions: NDArray[np.floating],
        starts: NDArray[np.float32] | None = None,
    ) -> Hits:
        """Return what rays meet first.

        Parameters
        ----------
        origin : (3,) float64 metres, of all rays, or (k, 3) of each.
        directions : (k, 3), of any length, the unit of the distances.
        starts : (k,) distances before which nothing counts; 0 if None.
        """
        rays = np.empty((len(directions), 6), np.float32)
        rays[:, :3] = self._scaled(origin if starts is None else origin + starts[:, None] * directions)
        rays[:, 3:] = directions
        found = self._scene.cast_rays(open3d().core.Tensor(rays))
        distances = found["t_hit"].numpy() / np.float32(self._scale)
        met = np.flatnonzero(np.isfinite(distances))
        if starts is not None:
            distances += starts
        u, v = found["primitive_uvs"].numpy()[met].T
        return Hits(
            met,
            found["primitive_ids"].numpy()[met].astype(np.int64),
            np.stack([1 - u - v, u, v], axis=1).clip(0, 1),
            distances[met],
            found["primitive_normals"].numpy()[met],
        )

    def nearest(self, points: Floats) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Return the triangle (k,) nearest to each of `points`, and how far it is, in single precision.

        Unlike `closest`, it takes all points at a time, of which there is one at least.
        """
        asked = self._scaled(points)
        found = self._scene.compute_closest_points(open3d().core.Tensor(asked))
        away = found["points"].numpy() - asked
        distances = np.sqrt(np.einsum("kx,kx->k", away, away)) / np.float32(self._scale)
        return found["primitive_ids"].numpy().astype(np.int64), distances

    def _closest(self, points: Floats) -> Located:
        found = self._scene.compute_closest_points(open3d().core.Tensor(self._scaled(points)))
        triangles = found["primitive_ids"].numpy().astype(np.int64)
        corners = self.mesh.vertices[self.mesh.triangles[triangles]]
        weights = closest_weights(points, corners)
        nearest = np.einsum("kc,kcx->kx", weights, corners)
        return Located(triangles, weights, np.linalg.norm(points - nearest, axis=1))

    def _scaled(self, points: Floats) -> NDArray[np.float32]:
        return np.asarray((points - self._center) * self._scale, np.float32)


def slimness_of(mesh: Mesh) -> Slimness:
    """Return how slim each triangle is."""
    count = len(mesh.triangles)
    sides2, area2_squared = np.zeros((3, count)), np.zeros(count)
    first, second = np.empty((3, count)), np.empty((3, count))
    # A coordinate at a time: several times as fast as rows of three, and this runs over all triangles.
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


def _without_slivers(mesh: Mesh, slimness: Slimness) -> Triangles:
    """Return the triangles with every sliver replaced by its longest side, as (first, second, second).

    In single precision the closest point of a sliver can come out anywhere along its line, and another
    triangle then be taken for the nearest; that of a side comes out right.
    """
    (slivers,) = np.nonzero(slimness.area2 <= _SLIVER * slimness.longest2)
    if not len(slivers):
        return mesh.triangles
    triangles: Triangles = mesh.triangles.copy()
    longest = slimness.longest[slivers]
    first, second = longest, (longest + 1) % 3
    triangles[slivers] = mesh.triangles[slivers[:, None], np.stack([first, second, second], axis=1)]
    return triangles


def unit_normals(mesh: Mesh) -> Floats:
    """Return the unit normals (m, 3) of a mesh's triangles; 0 for those without area."""
    # A coordinate at a time: several times as fast as rows of three.
    corners = np.array([[x.take(corner) for x in mesh.vertices.T] for corner in mesh.triangles.T])
    first, second = corners[1] - corners[0], corners[2] - corners[0]
    across = [first[i] * second[j] - first[j] * second[i] for i, j in ((1, 2), (2, 0), (0, 1))]
    lengths = np.sqrt(sum(x * x for x in across))
    normals = np.zeros((len(mesh.triangles), 3))
    for axis in range(3):
        np.divide(across[axis], lengths, out=normals[:, axis], where=lengths > 0)
    return normals


def bounding_box(*meshes: Mesh) -> Floats:
    """Return the lowest and the highest corner, (2, 3), of the box around the triangles of all meshes."""
    corners = [mesh.vertices.compress(is_used(mesh), axis=0) for mesh in meshes]
    # A column at a time: reducing over rows of three is several times slower.
    low = [min(points[:, axis].min() for points in corners) for axis in range(3)]
    high = [max(points[:, axis].max() for points in corners) for axis in range(3)]
    return np.array([low, high])


def is_used(mesh: Mesh) -> NDArray[np.bool_]:
    """Return which vertices (n,) a triangle uses."""
    used = np.zeros(len(mesh.vertices), bool)
    used[mesh.triangles] = True
    return used


def chunks(count: int) -> Iterator[slice]:
    """Yield slices that cover `count` rows, CHUNK at a time."""
    for start in range(0, count, CHUNK):
        yield slice(start, min(start + CHUNK, count))


def interpolated(values: NDArray[np.generic], mesh: Mesh, at: Located) -> Floats:
    """Return vertex values (n, d) interpolated at located points, (k, d) float64; all must be hits."""
    corners = values[mesh.triangles[at.triangles]].astype(np.float64)
    return np.asarray(np.einsum("kc,kcd->kd", at.weights, corners))


def closest_weights(points: Floats, corners: Floats) -> Floats:
    """Return the barycentric weights (k, 3) of the point of each triangle (k, 3, 3) nearest to each point.

    The foot of the perpendicular where it falls inside, else the nearest point of the three edges; a
    triangle without area has only its edges.
    """
    a = corners[:, 0]
    ab, ac, ap = corners[:, 1] - a, corners[:, 2] - a, points - a
    # By cross products, not by the normal equations: those square the condition, and slivers are common.
    normal = np.cross(ab, ac)
    squared = _dot(normal, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        v = _dot(np.cross(ap, ac), normal) / squared
        w = _dot(np.cross(ab, ap), normal) / squared
    weights = np.stack([1 - v - w, v, w], axis=1)
    outside = np.flatnonzero(~((weights >= 0).all(axis=1) & (squared > 0)))
    weights[outside] = _closest_on_edges(points[outside], corners[outside])
    return weights


def _closest_on_edges(points: Floats, corners: Floats) -> Floats:
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


def _joined(parts: list[Located]) -> Located:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return Located(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0))
    return Located(
        np.concatenate([p.triangles for p in parts]),
        np.concatenate([p.weights for p in parts]),
        np.concatenate([p.distances for p in parts]),
    )
