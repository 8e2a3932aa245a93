"""Meshes partitioned into cubes of space, which become chunks of large meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.simplification.mesh_subsets import split_chunk
from scanloom.stages.surface import chunk_partition, chunked_ply
from scanloom.stages.surface.chunk_partition import write_in_chunks
from scanloom.stages.surface.chunked_ply import ChunkedPly, make_table_path
from scanloom.stages.surface.formats.ply import read_ply, read_vertex_values, write_ply
from scanloom.stages.surface.mesh import Mesh

SIDE, SPACING = 40, 0.1


def _make_sheet() -> tuple[Mesh, dict[str, np.ndarray]]:
    """Make a wavy sheet of 3.9 m around the origin in random order, with two vertex values."""
    rng = np.random.default_rng(3)
    rows, columns = np.divmod(np.arange(SIDE * SIDE), SIDE)
    points = np.stack([columns, rows, 0 * rows], axis=1) * SPACING - 1.95
    points[:, 2] = 0.5 + 0.1 * np.sin(3 * points[:, 0])
    corner = (np.arange(SIDE - 1)[:, None] * SIDE + np.arange(SIDE - 1)).reshape(-1, 1)
    triangles = np.concatenate([np.add(corner, (0, 1, SIDE)), np.add(corner, (1, SIDE + 1, SIDE))])
    order = rng.permutation(len(points))
    rank = np.argsort(order)
    triangles = rng.permutation(rank[triangles]).astype(np.int32)
    values = {"deviation": rng.random(len(points), np.float32), "filled": np.ones(len(points), np.float32)}
    return Mesh(points[order], triangles, rng.integers(0, 255, (len(points), 3), np.uint8)), values


def _sort_corners(mesh: Mesh) -> np.ndarray:
    corners = mesh.vertices[mesh.triangles].reshape(-1, 9)
    return corners[np.lexsort(corners.T)]


@pytest.fixture
def path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", 1000)
    monkeypatch.setattr(chunk_partition, "CHUNK_SIZE_M", 1.0)
    mesh, values = _make_sheet()
    write_in_chunks(tmp_path / "mesh.ply", mesh, values)
    return tmp_path / "mesh.ply"


def test_the_surface_and_its_values_are_kept(path: Path) -> None:
    mesh, values = _make_sheet()
    found = read_ply(path)
    assert np.array_equal(_sort_corners(found), _sort_corners(mesh))
    rows = np.lexsort(found.vertices.T)
    expected = np.lexsort(mesh.vertices.T)
    assert np.array_equal(found.colors[rows], mesh.colors[expected])
    for name, value in values.items():
        assert np.array_equal(read_vertex_values(path, name)[rows], value[expected])
    whole = ChunkedPly(path).read_mesh()
    for name in ("vertices", "triangles", "colors"):
        assert np.array_equal(getattr(whole, name), getattr(found, name))
    assert not found.diagnostics


def test_a_chunk_has_the_vertices_in_its_cube(path: Path) -> None:
    chunks = ChunkedPly(path)
    assert len(chunks) == 16
    for number, extent in enumerate(chunks.extents):
        chunk = chunks.read_chunk(number)
        own = chunk.mesh.vertices[: chunk.own_count]
        assert ((own >= extent.low) & (own < extent.high)).all()
        assert np.subtract(extent.high, extent.low).tolist() == [1, 1, 1]
    longest = np.sqrt(2 + 0.3**2) * SPACING
    assert 0.99 * longest < 2 * chunks.spacing <= longest


def test_chunks_can_be_simplified_separately(path: Path) -> None:
    chunks = ChunkedPly(path)
    inside = [
        split_chunk(chunks.read_chunk(number), extent, 4 * chunks.spacing)[0]
        for number, extent in enumerate(chunks.extents)
    ]
    used = np.concatenate([one.global_indices for one in inside])
    assert len(np.unique(used)) == len(used) > 50


def test_the_file_does_not_depend_on_the_in_memory_limit(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", 5_000_000)
    write_in_chunks(tmp_path / "small.ply", *_make_sheet())
    assert not make_table_path(tmp_path / "small.ply").exists()
    assert (tmp_path / "small.ply").read_bytes() == path.read_bytes()


def test_the_order_within_a_cube_is_kept(tmp_path: Path) -> None:
    mesh, values = _make_sheet()
    mesh = mesh.with_(vertices=mesh.vertices + 2.0)
    write_in_chunks(tmp_path / "mesh.ply", mesh, values)
    write_ply(tmp_path / "expected.ply", mesh, vertex_values={k: v.astype(float) for k, v in values.items()})
    assert (tmp_path / "mesh.ply").read_bytes() == (tmp_path / "expected.ply").read_bytes()


def test_an_empty_mesh_is_an_empty_file(tmp_path: Path) -> None:
    write_in_chunks(tmp_path / "mesh.ply", Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), {})
    assert len(read_ply(tmp_path / "mesh.ply").vertices) == 0
