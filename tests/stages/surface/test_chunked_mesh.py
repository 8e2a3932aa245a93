"""Chunked meshes: neighbours across chunks, and global values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.surface import chunked_mesh, chunked_ply, in_memory_chunks
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.chunked_ply import ChunkedPly
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.in_memory_chunks import InMemoryChunks
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.surface.vertex_normals import compute_vertex_normals


@pytest.fixture(scope="module")
def whole(large: Path) -> Mesh:
    return read_ply(large)


@pytest.fixture(params=["file", "memory"])
def cut(
    large: Path, whole: Mesh, request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch
) -> ChunkedPly | InMemoryChunks:
    """Open the same mesh in a chunked file and in memory."""
    monkeypatch.setattr(in_memory_chunks, "_CHUNK_TRIANGLES", 700)
    return ChunkedPly(large) if request.param == "file" else InMemoryChunks(whole)


@pytest.mark.parametrize("at_once", [300, 500_000])
def test_vertex_normals_of_chunks_equal_those_of_the_mesh(
    cut: ChunkedPly | InMemoryChunks, whole: Mesh, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunked_mesh, "BATCH_TRIANGLES", at_once)
    expected = compute_vertex_normals(whole)
    met = count = done = 0
    for piece in ChunkedMesh(cut).iterate_batches(with_normals=True):
        count += 1
        own = piece.mesh.triangles
        rows = whole.triangles[done : done + len(own)]
        numbers = np.full(len(piece.mesh.vertices), -1)
        numbers[own] = rows
        assert (numbers[own] == rows).all()
        assert (piece.mesh.vertices == whole.vertices[numbers]).all()
        np.testing.assert_allclose(piece.normals, expected[numbers], atol=1e-5)
        assert (piece.box == compute_bounding_box(piece.mesh)).all()
        assert whole.colors is not None
        assert (piece.mesh.colors == whole.colors[numbers]).all()
        alone = compute_vertex_normals(piece.mesh)
        met += np.count_nonzero(np.abs(alone - expected[numbers]).max(axis=1) > 0.1)
        done += len(own)
    assert met > 100, "alone they would not"
    assert done == len(whole.triangles)
    assert count > (60 if at_once == 300 else 30)


def test_areas_and_boxes_equal_those_of_the_mesh(cut: ChunkedPly | InMemoryChunks, whole: Mesh) -> None:
    found = ChunkedMesh(cut)
    assert found.area_ends[-1] == np.cumsum(compute_areas(whole.vertices, whole.triangles))[-1]
    assert (found.box == compute_bounding_box(whole)).all()
    assert found.vertex_count == len(whole.vertices)
    some = found.sample_vertices(1000)
    assert len(some) == len(whole.vertices[:: 1 + len(whole.vertices) // 1000])
    assert {tuple(place) for place in some} <= {tuple(place) for place in whole.vertices}


@pytest.mark.parametrize("wanted", [1, 37, 1000, 10**6])
def test_sampled_vertices_do_not_depend_on_the_batch_size(
    large: Path, whole: Mesh, wanted: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunked_ply, "_VERTICES_PER_READ", 100)
    some = ChunkedMesh(ChunkedPly(large)).sample_vertices(wanted)
    assert (some == whole.vertices[:: 1 + len(whole.vertices) // wanted]).all()


def test_each_vertex_is_owned_by_one_chunk_in_order(cut: ChunkedPly | InMemoryChunks, whole: Mesh) -> None:
    end = done = 0
    places = np.full((len(whole.vertices), 3), np.nan)
    for part in ChunkedMesh(cut).iterate_chunks():
        own = part.global_indices[: part.own_count]
        assert (own == np.arange(end, end + part.own_count)).all()
        # Other vertices are known from earlier chunks or belong to a later chunk.
        places[own] = part.mesh.vertices[: part.own_count]
        end += part.own_count
        rows = whole.triangles[done : done + len(part.mesh.triangles)]
        assert (part.mesh.vertices[part.mesh.triangles] == whole.vertices[rows]).all()
        done += len(part.mesh.triangles)
    assert end == len(whole.vertices)
    for part in ChunkedMesh(cut).iterate_chunks():
        assert (places[part.global_indices] == part.mesh.vertices).all()


def test_distance_bounds_hold(cut: ChunkedPly | InMemoryChunks, whole: Mesh) -> None:
    low, high = compute_bounding_box(whole)
    points = np.random.default_rng(0).uniform(low - 1, high + 1, (500, 3))
    assert (
        RaycastingSurface(whole).find_closest_points(points).distances
        <= ChunkedMesh(cut).bound_distances(points) + 1e-12
    ).all()
