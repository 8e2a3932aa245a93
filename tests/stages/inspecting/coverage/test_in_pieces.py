"""Coverage of a chunked mesh equals coverage of the mesh in memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from chunked_meshes import split_into_chunks
from flat_plates import plate, remove_triangles, render_frames

from scanloom import coverage, read_scan
from scanloom.stages.inspecting.coverage import probes
from scanloom.stages.inspecting.coverage.boundary import find_boundary
from scanloom.stages.inspecting.coverage.coverage_result import Coverage
from scanloom.stages.inspecting.coverage.occlusion_test import OcclusionTest
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface import chunked_mesh
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh
from scanloom.stages.surface.chunked_ply import ChunkedPly
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.raycasting import RaycastingSurface

_SAMPLE = Path(__file__).resolve().parents[4] / "samples" / "rgbd"


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    """Read frames from one side only, so that there are several kinds of defects."""
    return list(read_scan(_SAMPLE).frames[:8])


@pytest.fixture(scope="module")
def whole(large: Path, frames: list[Frame]) -> Coverage:
    return coverage(read_ply(large), frames, few_frames=2, spacing=0.03)


@pytest.fixture(scope="module")
def pieced(large: Path, frames: list[Frame]) -> Coverage:
    with pytest.MonkeyPatch.context() as patch:
        # Some chunks are processed in several batches.
        patch.setattr(chunked_mesh, "BATCH_TRIANGLES", 300)
        surface = ChunkedMesh(ChunkedPly(large))
        assert len(surface) > 5
        assert len(list(surface.iterate_batches())) > len(surface)
        found = coverage(surface, frames, few_frames=2, spacing=0.03)
        # Vertex values are only read on access.
        found.painted_mesh  # noqa: B018
    return found


def test_metrics_and_defects_equal_those_of_the_mesh_in_memory(whole: Coverage, pieced: Coverage) -> None:
    expected, told = whole.to_dict(), pieced.to_dict()
    assert len(expected["places"]) > 10
    assert {place.kind for place in whole.defects} == {"hidden", "few", "oblique", "unmeasured", "apart"}
    assert [one.pop("nearest_frames") for one in told["places"]] == [
        one.pop("nearest_frames") for one in expected["places"]
    ]
    for one, other in zip(expected.pop("places"), told.pop("places"), strict=True):
        for name, value in one.items():
            assert other[name] == (value if isinstance(value, str) else pytest.approx(value, rel=1e-6))
    for name, value in expected.items():
        assert told[name] == (value if isinstance(value, list) else pytest.approx(value, rel=1e-6))


def test_colours_and_vertex_values_equal_those_of_the_mesh_in_memory(
    whole: Coverage, pieced: Coverage
) -> None:
    np.testing.assert_array_equal(pieced.painted_mesh.vertices, whole.painted_mesh.vertices)
    np.testing.assert_array_equal(pieced.painted_mesh.triangles, whole.painted_mesh.triangles)
    off = np.abs(pieced.painted_mesh.colors.astype(int) - whole.painted_mesh.colors.astype(int))
    # At chunk borders, normals are summed in single precision.
    assert off.max() <= 1
    np.testing.assert_array_equal(pieced.vertex_kinds, whole.vertex_kinds)
    for name in ("frame_counts", "max_cosine", "min_distance", "min_pixel_size", "mean_cosine", "rms_height"):
        values = getattr(pieced.vertex_evidence, name)
        np.testing.assert_allclose(values, getattr(whole.vertex_evidence, name), rtol=1e-4, atol=1e-7)
    assert len(whole.painted_mesh.vertices) > len(whole.vertex_kinds) == len(pieced.vertex_kinds)


def test_boundary_loops_across_chunks_equal_those_of_the_mesh_in_memory(large: Path) -> None:
    one, many = find_boundary(SingleChunkMesh(read_ply(large))), find_boundary(ChunkedMesh(ChunkedPly(large)))
    assert len(one.tails) > 100
    for name in ("tails", "heads", "starts", "ends"):
        np.testing.assert_array_equal(getattr(many, name), getattr(one, name))
    for name in ("normal_sums", "triangle_normals"):
        np.testing.assert_allclose(getattr(many, name), getattr(one, name), atol=1e-6)


def test_a_hole_across_four_chunks_is_reported_like_in_memory(tmp_path: Path) -> None:
    wall = plate((-0.8, 0, 0), (1.6, 0, 0), (0, 0, 1.2), 0.02)
    open_wall = remove_triangles(
        wall, lambda p: (np.abs(p[:, 0] - 0.1) < 0.15) & (np.abs(p[:, 2] - 0.5) < 0.1)
    )
    # There is no depth, because the hole is a pane of glass.
    frames = render_frames(open_wall, [((x, -1.2, 0.6), (x, 0, 0.6)) for x in (-0.2, 0.0, 0.2)])
    middles = open_wall.vertices[open_wall.triangles].mean(axis=1)
    large = split_into_chunks(
        tmp_path / "wall.ply", open_wall, (middles[:, 0] > 0.1) + 2 * (middles[:, 2] > 0.5)
    )
    assert len(large) == 4

    (expected,) = [one for one in coverage(open_wall, frames).defects if one.kind == "hole"]
    (hole,) = [one for one in coverage(large, frames).defects if one.kind == "hole"]
    assert hole.area == pytest.approx(expected.area, rel=1e-9)
    assert hole.area == pytest.approx(0.3 * 0.2, rel=0.15)
    np.testing.assert_allclose(hole.point, (0.1, 0, 0.5), atol=0.06)


def test_probes_are_close_to_their_vertices_for_any_mesh_size(
    large: Path, frames: list[Frame], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(probes, "_TARGET_COUNT", 10)
    for mesh in (read_ply(large), ChunkedMesh(ChunkedPly(large))):
        found = coverage(mesh, frames).surface_coverage
        vertices = read_ply(large).vertices - found.surface.box.mean(axis=0)
        stands = np.concatenate([part.probe_indices for part in found.iterate_painted()])[: len(vertices)]
        away = np.linalg.norm(found.probes.points[stands] - vertices, axis=1)
        # The fused mesh has voxels of 15 mm and shorter edges. Next to rims, the probe of another cell may
        # represent a vertex.
        assert np.quantile(away, 0.95) < 6 * 0.015
        assert 200 < len(found.probes.points) < len(vertices) / 4


def test_rays_hit_chunks_like_the_mesh_in_memory(large: Path) -> None:
    mesh, pieced = read_ply(large), ChunkedMesh(ChunkedPly(large))
    rng = np.random.default_rng(3)
    low, high = pieced.box
    origins = rng.uniform(low - 0.2, high + 0.2, (3000, 3))
    directions = rng.normal(size=(3000, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    # Some rays parallel to box axes.
    directions[:300] = np.eye(3)[rng.integers(0, 3, 300)]
    reaches = rng.uniform(0.05, 1.0, 3000)
    hits = RaycastingSurface(mesh, pieced.box).cast_rays(origins, directions)
    expected = np.zeros(3000, bool)
    expected[hits.rays] = hits.distances <= reaches[hits.rays]
    assert 100 < expected.sum() < 2900
    for surface in (SingleChunkMesh(mesh), pieced):
        np.testing.assert_array_equal(OcclusionTest(surface).is_hit(origins, directions, reaches), expected)
