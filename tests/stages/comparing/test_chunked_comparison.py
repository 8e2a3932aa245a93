"""Distances from and to a chunked mesh equal in-memory distances, also at faces between chunks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanloom.stages.comparing import chunked_comparison
from scanloom.stages.comparing.chunked_comparison import compare_chunked
from scanloom.stages.comparing.compare import CompareParams, compare
from scanloom.stages.comparing.comparison_inputs import compute_joint_box
from scanloom.stages.comparing.deviations import DeviationParams, deviations
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface import chunked_ply
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.chunked_ply import ChunkedPly, ChunkExtent, WrittenChunk
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats

PARAMS = CompareParams(samples=20_000)
SIGNED = DeviationParams(signed_samples=5_000)

pytestmark = pytest.mark.usefixtures("few_at_a_time")


@pytest.fixture(scope="module")
def read_whole(large: Path) -> Mesh:
    return read_ply(large)


def compare_with_chunks(path: Path, read_whole: Mesh, mesh: Mesh) -> tuple[Any, Any]:
    box: Floats = compute_joint_box(read_whole, mesh)
    return compare_chunked(ChunkedMesh(ChunkedPly(path)), mesh, PARAMS, box=box, signed=(mesh, SIGNED))


def assert_near(found: Any, expected: Any) -> None:
    """Compare recursively; equal samples have equal distances up to rounding."""
    if isinstance(expected, dict):
        assert found.keys() == expected.keys()
        for name, value in expected.items():
            assert_near(found[name], value)
    elif isinstance(expected, list):
        assert len(found) == len(expected)
        for one, other in zip(found, expected, strict=True):
            assert_near(one, other)
    else:
        assert found == (pytest.approx(expected, rel=1e-6, abs=1e-9) if expected else expected)


def test_metrics_equal_those_of_the_mesh_in_memory(large: Path, read_whole: Mesh) -> None:
    light = simplify(read_whole, ratio=0.1).mesh
    found, signed = compare_with_chunks(large, read_whole, light)
    assert_near(found.to_dict(), compare(read_whole, light, PARAMS).to_dict())
    expected = deviations(read_whole, light, SIGNED)
    assert_near(signed.to_dict(), expected.to_dict())
    np.testing.assert_allclose(signed.vertex_distances, expected.vertex_distances, atol=1e-7)
    assert found.to_dict()["color"] is not None
    assert signed.is_signed


def test_points_above_a_ridge_between_chunks_are_outside(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A steep roof with one chunk per side: a single side would treat points above the other side as inside.
    feet = [[x, y, -1] for x in (-0.27, 0.27) for y in (0, 1)]
    vertices = np.array([[0, 0, 0], [0, 1, 0], *feet], np.float64)
    triangles = np.array([[0, 1, 3], [0, 3, 2], [1, 0, 4], [1, 4, 5]], np.int32)
    monkeypatch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", 1)
    sizes = [
        ChunkExtent((0, 4), (0, 2), (-1, 0, -1), (0, 1, 0)),
        ChunkExtent((4, 6), (2, 4), (0, 0, -1), (1, 1, 0)),
    ]
    parts = [WrittenChunk(vertices[:4], None, triangles[:2]), WrittenChunk(vertices[4:], None, triangles[2:])]
    path = tmp_path / "roof.ply"
    chunked_ply.write_chunked_ply(path, sizes, parts, has_colors=False, spacing=1.0)
    above = Mesh(
        np.array([[-0.05, 0.2, 0.1], [0.05, 0.2, 0.1], [0.05, 0.8, 0.1]]), np.array([[0, 1, 2]], np.int32)
    )
    found, signed = compare_with_chunks(path, Mesh(vertices, triangles), above)
    assert signed.is_signed
    np.testing.assert_allclose(signed.vertex_distances, np.hypot(0.05, 0.1))
    assert signed.sample_distances.min() > 0
    assert found.to_dict()["color"] is None


def test_far_points_are_found(large: Path, read_whole: Mesh) -> None:
    away = np.array([[0, 0, 9.0], [1, 0, 9], [0, 1, 9]])
    triangle = Mesh(np.vstack([away, read_whole.vertices[:3]]), np.array([[0, 1, 2], [3, 4, 5]], np.int32))
    found, _ = compare_with_chunks(large, read_whole, triangle)
    assert_near(found.to_dict(), compare(read_whole, triangle, PARAMS).to_dict())


def test_chunks_are_searched_only_for_nearby_points(
    large: Path, read_whole: Mesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []

    class Counting(NeedleSafeSurface):
        def find_closest_points(self, points: Floats) -> Any:
            asked.append(len(points))
            return super().find_closest_points(points)

    monkeypatch.setattr(chunked_comparison, "NeedleSafeSurface", Counting)
    light = simplify(read_whole, ratio=0.1).mesh
    compare_with_chunks(large, read_whole, light)
    points = PARAMS.samples + SIGNED.signed_samples + 2 * len(light.vertices)
    assert points <= sum(asked) < 2 * points
