"""What the result of every kernel is held to, told by other means than the kernel's own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.raycasting import compute_closest_weights

_POINTS = 300


def assert_sound(mesh: Mesh) -> None:
    """Indices are in range, all numbers finite, and no triangle has a vertex twice."""
    validate_mesh(mesh)
    a, b, c = mesh.triangles.T
    assert not ((a == b) | (b == c) | (c == a)).any(), "a triangle has a vertex twice"
    if mesh.texture is not None:
        assert np.isfinite(mesh.texture.uvs).all(), "a texture coordinate is not finite"


def border_edges(mesh: Mesh) -> int:
    """Return how many edges have not two triangles, vertices in the same place taken as one."""
    _, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[mesh.triangles]
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    return int((counts % 2).sum())


def assert_manifold(triangles: NDArray[np.int32], count: int) -> None:
    """Every edge has one triangle, or two that look to one side, and every vertex one fan; none is unused.

    Parameters
    ----------
    triangles : (m, 3), of vertices that are apart by their numbers.
    count : of vertices.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if len(triangles) == 0:
        assert count == 0, "vertices without a triangle"
        return
    assert 0 <= triangles.min() <= triangles.max() < count, "an index is out of range"
    starts, ends = triangles.reshape(-1), np.roll(triangles, -1, axis=1).reshape(-1)
    assert (starts != ends).all(), "a triangle has a vertex twice"
    ways = starts.astype(np.int64) * count + ends
    assert len(np.unique(ways)) == len(ways), "an edge has two triangles that look to different sides"
    # Corners at both ends of an edge belong together with those of its other triangle.
    back = ends.astype(np.int64) * count + starts
    order = np.argsort(ways)
    place = np.minimum(np.searchsorted(ways, back, sorter=order), len(ways) - 1)
    other = order[place]
    one = np.nonzero(ways[other] == back)[0]
    other = other[one]
    following = np.arange(len(ways)).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    links = np.concatenate([one, following[one]]), np.concatenate([following[other], other])
    corners = coo_array((np.ones(len(links[0]), bool), links), shape=(len(ways), len(ways)))
    fans = connected_components(corners, directed=False)[0]
    assert len(np.unique(starts)) == count, "vertices without a triangle"
    assert fans == count, "a vertex joins two fans of triangles"


def assert_same_bytes(one: Mesh, other: Mesh) -> None:
    """A result is the same on any number of threads."""
    for name in ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), f"threads decide whether there are {name}"
        assert a is None or a.tobytes() == b.tobytes(), f"threads decide {name}"
    if one.texture is not None and other.texture is not None:
        assert one.texture.uvs.tobytes() == other.texture.uvs.tobytes(), "threads decide texture coordinates"


def sampled_distance(mesh: Mesh, other: Mesh, rng: np.random.Generator, *, lines: bool) -> float:
    """Return the greatest distance, metres, of some points of one mesh from the other; in double precision.

    A true bound on all points is no smaller. Triangles with two corners in one place are looked
    at with `lines`: simplifying leaves them out, and says so where nothing else is there.
    """
    points = _points_on(mesh, rng, lines=lines)
    corners = other.vertices[other.triangles]
    nearest = np.full(len(points), np.inf)
    # Every triangle is looked at, so that no tree has to be trusted.
    for at, point in enumerate(points):
        repeated = np.broadcast_to(point, (len(corners), 3))
        weights = compute_closest_weights(repeated, corners)
        there = np.einsum("ij,ijk->ik", weights, corners)
        nearest[at] = np.linalg.norm(there - point, axis=1).min()
    return float(nearest.max(initial=0.0))


def _points_on(mesh: Mesh, rng: np.random.Generator, *, lines: bool) -> NDArray[np.float64]:
    corners = mesh.vertices[mesh.triangles]
    if not lines:
        a, b, c = (corners[:, i] for i in range(3))
        corners = corners[~((a == b).all(axis=1) | (b == c).all(axis=1) | (c == a).all(axis=1))]
    if len(corners) == 0:
        return np.zeros((0, 3))
    chosen = rng.integers(0, len(corners), _POINTS)
    weights = rng.dirichlet((0.6, 0.6, 0.6), _POINTS)
    return np.asarray(np.einsum("ij,ijk->ik", weights, corners[chosen]))
