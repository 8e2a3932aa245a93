"""Rules for results of kernels, checked independently of the kernels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.raycasting import compute_closest_weights

_POINTS = 300


def assert_sound(mesh: Mesh) -> None:
    """Check that indices are in range, numbers are finite, and triangles have three different vertices."""
    validate_mesh(mesh)
    a, b, c = mesh.triangles.T
    assert not ((a == b) | (b == c) | (c == a)).any(), "a triangle has a vertex twice"
    if mesh.texture is not None:
        assert np.isfinite(mesh.texture.uvs).all(), "a texture coordinate is not finite"


def count_border_edges(mesh: Mesh) -> int:
    """Count edges with an odd number of triangles, after welding vertices at equal positions."""
    _, number = np.unique(mesh.vertices, axis=0, return_inverse=True)
    triangles = number.reshape(-1)[mesh.triangles]
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    counts = np.unique(edges, axis=0, return_counts=True)[1]
    return int((counts % 2).sum())


def assert_manifold(triangles: NDArray[np.int32], count: int) -> None:
    """Check that edges have one triangle or two consistent ones, and vertices one fan; none is unused.

    Parameters
    ----------
    triangles : (m, 3); vertices are distinguished by index, not by position.
    count : number of vertices.
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
    # Corners at both ends of an edge are connected to the corners of its other triangle.
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
    """Check that a result does not depend on the thread count."""
    for name in ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids"):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), f"the presence of {name} depends on the thread count"
        assert a is None or a.tobytes() == b.tobytes(), f"{name} depend on the thread count"
    if one.texture is not None and other.texture is not None:
        assert one.texture.uvs.tobytes() == other.texture.uvs.tobytes(), (
            "texture coordinates depend on the thread count"
        )


def measure_sampled_distance(mesh: Mesh, other: Mesh, rng: np.random.Generator, *, lines: bool) -> float:
    """Measure the maximum distance of sampled points of one mesh to another, metres.

    The computation is in double precision. A true bound for all points is at least as large. Triangles with
    two corners at one position count only with `lines`: `simplify` drops them, and reports it if nothing else
    is there.
    """
    points = _sample_points(mesh, rng, lines=lines)
    corners = other.vertices[other.triangles]
    nearest = np.full(len(points), np.inf)
    # All triangles are searched, so that the result does not rely on a search tree.
    for at, point in enumerate(points):
        repeated = np.broadcast_to(point, (len(corners), 3))
        weights = compute_closest_weights(repeated, corners)
        there = np.einsum("ij,ijk->ik", weights, corners)
        nearest[at] = np.linalg.norm(there - point, axis=1).min()
    return float(nearest.max(initial=0.0))


def _sample_points(mesh: Mesh, rng: np.random.Generator, *, lines: bool) -> NDArray[np.float64]:
    corners = mesh.vertices[mesh.triangles]
    if not lines:
        a, b, c = (corners[:, i] for i in range(3))
        corners = corners[~((a == b).all(axis=1) | (b == c).all(axis=1) | (c == a).all(axis=1))]
    if len(corners) == 0:
        return np.zeros((0, 3))
    chosen = rng.integers(0, len(corners), _POINTS)
    weights = rng.dirichlet((0.6, 0.6, 0.6), _POINTS)
    return np.asarray(np.einsum("ij,ijk->ik", weights, corners[chosen]))
