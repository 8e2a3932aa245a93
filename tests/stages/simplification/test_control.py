"""User control of a simplification: locked vertices, importance, regions."""

from __future__ import annotations

import numpy as np
import pytest
from coloured_meshes import assert_same_topology, ball, sheet

from scanloom.stages.simplification.regions import Box, Sphere
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology


@pytest.mark.parametrize("fit", [True, False], ids=["fitted", "plain"])
def test_locked_vertices_are_kept_exactly(fit: bool) -> None:
    mesh = sheet(150)
    lock = np.random.default_rng(5).choice(len(mesh.vertices), 400, replace=False)
    result = simplify(mesh, ratio=0.05, lock=lock, fit=fit)
    assert len(result.mesh.triangles) <= 0.05 * len(mesh.triangles)
    assert_same_topology(result.mesh, mesh)
    assert set(lock.tolist()) <= set(result.vertex_source.tolist())
    at = np.searchsorted(result.vertex_source, np.sort(lock))
    assert result.mesh.colors is not None
    assert mesh.colors is not None
    assert result.mesh.vertices[at].tobytes() == mesh.vertices[np.sort(lock)].tobytes()
    np.testing.assert_array_equal(result.mesh.colors[at], mesh.colors[np.sort(lock)])


@pytest.mark.parametrize(
    "changes",
    [
        {"triangles": 1},
        {"max_shape": 1.0},
        {"method": "jia01", "max_shape": 1.0, "max_color": 1e9},
    ],
)
def test_a_completely_locked_mesh_is_unchanged(changes: dict[str, float]) -> None:
    mesh = ball()
    result = simplify(mesh, lock=np.ones(len(mesh.vertices), bool), **changes)
    np.testing.assert_array_equal(result.mesh.vertices, mesh.vertices)
    np.testing.assert_array_equal(result.mesh.triangles, mesh.triangles)
    assert result.refused["locked"] == topology(mesh).edges


@pytest.mark.parametrize("method", ["certified", "jia01"])
def test_bounded_methods_keep_locked_vertices(method: str) -> None:
    mesh = sheet()
    lock = np.linalg.norm(mesh.vertices[:, :2] - 0.5, axis=1) < 0.2
    result = simplify(mesh, method=method, max_shape=0.01, lock=lock)
    assert len(result.mesh.triangles) < 0.7 * len(mesh.triangles)
    at = np.searchsorted(result.vertex_source, np.flatnonzero(lock))
    np.testing.assert_array_equal(result.mesh.vertices[at], mesh.vertices[lock])


def count_centers_within(mesh: Mesh, low: float, high: float) -> int:
    x = mesh.vertices[mesh.triangles].mean(axis=1)[:, 0]
    return int(((low <= x) & (x <= high)).sum())


def test_importance_keeps_more_triangles() -> None:
    mesh = sheet(60)
    left = np.where(mesh.vertices[:, 0] < 0.5, 100.0, 1.0)
    even, uneven = (simplify(mesh, triangles=600, importance=i) for i in (None, left))
    # The last collapse removes two triangles, or one at the boundary.
    assert {len(even.mesh.triangles), len(uneven.mesh.triangles)} <= {599, 600}
    assert_same_topology(uneven.mesh, mesh)
    assert count_centers_within(uneven.mesh, 0, 0.5) > 1.5 * count_centers_within(even.mesh, 0, 0.5)


def test_uniform_importance_has_no_effect() -> None:
    mesh = sheet()
    eight = np.full(len(mesh.vertices), 8.0)
    np.testing.assert_array_equal(
        simplify(mesh, ratio=0.1, importance=eight).mesh.vertices, simplify(mesh, ratio=0.1).mesh.vertices
    )


def test_regions_are_equal_to_values_of_their_vertices() -> None:
    mesh = sheet()
    own = np.random.default_rng(1).uniform(0.5, 3.0, len(mesh.vertices))
    regions = (
        Sphere((0.25, 0.25, 0.0), 0.2, importance=20.0),
        Sphere((0.3, 0.25, 0.0), 0.2, importance=5.0),
        Box((0.7, 0.7, -1.0), (0.8, 0.9, 1.0), lock=True),
    )
    x, y, z = mesh.vertices.T
    near = [(x - c) ** 2 + (y - 0.25) ** 2 + z**2 <= 0.2**2 for c in (0.25, 0.3)]
    factors = np.maximum(own, np.where(near[0], 20.0, np.where(near[1], 5.0, 0.0)))
    boxed = (x >= 0.7) & (x <= 0.8) & (y >= 0.7) & (y <= 0.9)
    by_regions = simplify(mesh, ratio=0.2, importance=own, lock=[0, 5], regions=regions)
    by_values = simplify(mesh, ratio=0.2, importance=factors, lock=boxed | np.isin(np.arange(len(x)), [0, 5]))
    assert boxed.sum() > 10
    np.testing.assert_array_equal(by_regions.mesh.vertices, by_values.mesh.vertices)
    np.testing.assert_array_equal(by_regions.mesh.triangles, by_values.mesh.triangles)
