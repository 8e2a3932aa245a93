"""Large meshes in random order are processed in spatial order, and results use the original indices."""

from __future__ import annotations

import numpy as np
import pytest

from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.spatial_order import is_scattered, permute_rows, reorder_spatially

N = 330


@pytest.fixture(scope="module")
def sheet() -> Mesh:
    """Make a wavy, coloured sheet in row order."""
    y, x = np.mgrid[0:N, 0:N].astype(float)
    vertices = np.stack([x, y, 2 * np.sin(x / 9) * np.cos(y / 7)], -1).reshape(-1, 3)
    a = (np.arange(N - 1)[:, None] * N + np.arange(N - 1)).ravel()
    triangles = np.concatenate([np.stack([a, a + 1, a + N + 1], 1), np.stack([a, a + N + 1, a + N], 1)])
    colors = np.stack([x, y, x + y], -1).reshape(-1, 3) % 256
    return Mesh(vertices, triangles[np.argsort(triangles[:, 0])].astype(np.int32), colors.astype(np.uint8))


@pytest.fixture(scope="module")
def scattered(sheet) -> Mesh:
    random = np.random.default_rng(0)
    return permute_rows(
        sheet, random.permutation(len(sheet.vertices)), random.permutation(len(sheet.triangles))
    )


def get_corners(mesh: Mesh) -> np.ndarray:
    return mesh.vertices[mesh.triangles]


def test_row_order_is_distinguished_from_random_order(sheet, scattered):
    assert not is_scattered(sheet)
    assert is_scattered(scattered)
    assert not is_scattered(reorder_spatially(scattered).mesh)
    assert not is_scattered(Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)))


def test_an_order_contains_every_index_once(scattered):
    order = reorder_spatially(scattered)
    assert np.array_equal(order.mesh.vertices, scattered.vertices[order.vertex_source])
    assert np.array_equal(order.mesh.colors, scattered.colors[order.vertex_source])
    assert np.array_equal(get_corners(order.mesh), get_corners(scattered)[order.triangle_source])
    back = permute_rows(order.mesh, np.argsort(order.vertex_source), np.argsort(order.triangle_source))
    assert np.array_equal(back.vertices, scattered.vertices)
    assert np.array_equal(back.triangles, scattered.triangles)


@pytest.mark.slow
def test_results_use_the_original_indices(scattered):
    lock = np.arange(0, len(scattered.vertices), 5003)
    found = simplify(scattered, ratio=0.05, lock=lock)
    again = simplify(scattered, ratio=0.05, lock=lock, threads=1)
    assert np.array_equal(found.mesh.vertices, again.mesh.vertices)
    assert np.array_equal(found.mesh.triangles, again.mesh.triangles)
    assert found.stopped_by == "triangles"
    for source, count in ((found.vertex_source, len(scattered.vertices)), (found.triangle_source, 2 * N * N)):
        assert source.dtype == np.int32
        assert (np.diff(source) > 0).all()
        assert source[0] >= 0
        assert source[-1] < count
    kept = np.isin(found.vertex_source, lock)
    assert kept.sum() == len(lock)
    assert np.array_equal(found.mesh.vertices[kept], scattered.vertices[lock])
    assert np.array_equal(found.mesh.colors[kept], scattered.colors[lock])
    # The remaining part of a triangle is still close to its original position.
    away = np.linalg.norm(
        get_corners(found.mesh).mean(1) - get_corners(scattered)[found.triangle_source].mean(1), axis=1
    )
    assert np.quantile(away, 0.99) < 20


@pytest.mark.slow
def test_reordering_costs_no_accuracy(sheet, scattered):
    def height_error(mesh: Mesh) -> float:
        x, y, z = simplify(mesh, ratio=0.05).mesh.vertices.T
        return float(np.sqrt(np.mean((2 * np.sin(x / 9) * np.cos(y / 7) - z) ** 2)))

    assert height_error(scattered) < 1.05 * height_error(sheet)


def test_non_manifold_parts_are_split_with_original_indices(scattered):
    extra = np.append(scattered.triangles[7, :2], scattered.triangles[9, 2]).astype(np.int32)
    broken = scattered.with_(triangles=np.concatenate([scattered.triangles, extra[None]]))
    assert is_scattered(broken)
    light = simplify(broken, ratio=0.05)
    assert any("split into sheets" in str(one) for one in light.diagnostics)
    # Vertices where sheets touch are kept under their original indices.
    ends = np.isin(light.vertex_source, extra[:2])
    assert set(light.vertex_source[ends]) == set(extra[:2])
    assert np.array_equal(light.mesh.vertices[ends], broken.vertices[light.vertex_source[ends]])
