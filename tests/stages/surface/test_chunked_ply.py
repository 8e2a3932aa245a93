"""Chunked PLY files: valid PLY files that can also be read by chunks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface import chunked_ply
from scanloom.stages.surface.chunked_ply import (
    ChunkedPly,
    ChunkExtent,
    WrittenChunk,
    make_table_path,
    write_chunked_ply,
)
from scanloom.stages.surface.formats.ply import read_ply, write_ply
from scanloom.stages.surface.mesh import Mesh

# A strip of four triangles; the last two are the second chunk.
VERTICES = np.array([[x, y, 0.1 * x] for x in (0, 1, 2) for y in (0, 1)], float)
TRIANGLES = np.array([[0, 2, 1], [1, 2, 3], [2, 4, 3], [3, 4, 5]], np.int32)
COLORS = np.arange(18, dtype=np.uint8).reshape(6, 3)
SIZES = [ChunkExtent((0, 2), (0, 2), (0, 0, 0), (1, 1, 1)), ChunkExtent((2, 6), (2, 4), (1, 0, 0), (3, 1, 1))]


@pytest.fixture(autouse=True)
def _any_mesh_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", -1)


def write_chunks(path: Path, *, colors: bool = True) -> Path:
    parts = [
        WrittenChunk(
            VERTICES[slice(*s.vertices)],
            COLORS[slice(*s.vertices)] if colors else None,
            TRIANGLES[slice(*s.triangles)],
        )
        for s in SIZES
    ]
    write_chunked_ply(path, SIZES, parts, has_colors=colors, spacing=1.0)
    return path


@pytest.mark.parametrize("colors", [True, False])
def test_the_file_equals_an_ordinary_ply_file(colors: bool, tmp_path: Path) -> None:
    path = write_chunks(tmp_path / "mesh.ply", colors=colors)
    write_ply(tmp_path / "whole.ply", Mesh(VERTICES, TRIANGLES, COLORS if colors else None))
    assert path.read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_a_chunk_has_the_vertices_it_uses(tmp_path: Path) -> None:
    found = ChunkedPly(write_chunks(tmp_path / "mesh.ply"))
    assert (len(found), found.vertex_count, found.triangle_count, found.spacing) == (2, 6, 4, 1.0)
    first = found.read_chunk(0)
    assert first.own_count == 2
    assert first.global_indices.tolist() == [0, 1, 2, 3]
    assert (first.mesh.vertices[first.mesh.triangles] == VERTICES[TRIANGLES[:2]]).all()
    assert (first.mesh.colors == COLORS[:4]).all()
    second = found.read_chunk(1)
    assert second.global_indices.tolist() == [2, 3, 4, 5]
    assert (second.global_indices[second.mesh.triangles] == TRIANGLES[2:]).all()


def test_inconsistent_files_are_refused(tmp_path: Path) -> None:
    path = write_chunks(tmp_path / "mesh.ply")
    whole = path.read_bytes()
    path.write_bytes(whole[:-1])
    with pytest.raises(InputError, match="damaged, or does not match"):
        ChunkedPly(path)
    path.write_bytes(whole[:-4] + np.array(99, "<i4").tobytes())
    with pytest.raises(InputError, match="a vertex that does not exist"):
        ChunkedPly(path).read_chunk(1)
    path.write_bytes(whole)
    table = json.loads(make_table_path(path).read_text())
    for wrong in (
        {},
        {**table, "pieces": table["pieces"][1:]},
        {**table, "has_colors": False},
        {**table, "pieces": 3},
    ):
        make_table_path(path).write_text(json.dumps(wrong))
        with pytest.raises(InputError):
            ChunkedPly(path)


def test_a_small_mesh_has_no_chunk_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(chunked_ply, "MAX_IN_MEMORY_TRIANGLES", len(TRIANGLES))
    assert not make_table_path(write_chunks(tmp_path / "mesh.ply")).exists()
    assert len(read_ply(tmp_path / "mesh.ply").triangles) == len(TRIANGLES)


def test_no_chunks_are_an_empty_mesh(tmp_path: Path) -> None:
    write_chunked_ply(tmp_path / "mesh.ply", [], [], has_colors=False, spacing=1.0)
    assert len(ChunkedPly(tmp_path / "mesh.ply")) == 0
    assert len(read_ply(tmp_path / "mesh.ply").triangles) == 0
