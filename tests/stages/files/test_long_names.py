"""File names may have the maximum length of the file system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coloured_meshes import ball
from seamed_meshes import wrapped_ball

from scanloom.pipeline.cache.atomic_files import copy_atomically, remove_abandoned_drafts, write_atomically
from scanloom.stages.files.atomic_files import create_draft_path, write_file_atomically
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.rendering.render import write_png
from scanloom.stages.simplification.records.archive import write_arrays
from scanloom.stages.surface.formats.ply import write_ply_cloud
from scanloom.stages.surface.mesh_files import read_mesh, write_mesh

LENGTHS = (240, 241, 251, 255)


def make_longest_name(extension: str, length: int = 255) -> str:
    return "é" * ((length - len(extension)) // 2) + "x" * ((length - len(extension)) % 2) + extension


@pytest.mark.parametrize("length", LENGTHS)
def test_a_file_with_a_long_name_is_written(tmp_path: Path, length: int) -> None:
    path = tmp_path / make_longest_name(".bin", length)
    assert len(path.name.encode()) == length
    with write_file_atomically(path) as part:
        assert part.parent == tmp_path
        part.write_bytes(b"content")
    write_atomically(path, b"other content")
    copy_atomically(path, tmp_path / make_longest_name(".too", length))
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == {
        path.name: b"other content",
        make_longest_name(".too", length): b"other content",
    }


def test_drafts_of_long_names_are_removed(tmp_path: Path) -> None:
    path, other = (tmp_path / make_longest_name(extension) for extension in (".bin", ".too"))
    for each in (path, path, other):
        create_draft_path(each).write_bytes(b"half")
    remove_abandoned_drafts(path)
    assert len(list(tmp_path.iterdir())) == 1
    remove_abandoned_drafts(other)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("extension", [".ply", ".obj", ".off", ".stl", ".glb", ".gltf"])
@pytest.mark.parametrize("length", [251, 255])
def test_meshes_with_long_names_are_written_and_read(tmp_path: Path, extension: str, length: int) -> None:
    path = tmp_path / make_longest_name(extension, length)
    mesh = wrapped_ball(6, 8)
    write_mesh(path, mesh)
    assert len(read_mesh(path).triangles) == len(mesh.triangles)
    if extension in (".ply", ".obj", ".gltf"):
        assert read_mesh(path).texture is not None
    assert not list(tmp_path.glob(".*"))


@pytest.mark.slow
def test_other_writers_accept_long_names(tmp_path: Path) -> None:
    write_png(tmp_path / make_longest_name(".png"), np.zeros((2, 2, 3), np.uint8))
    write_arrays(tmp_path / make_longest_name(".npz"), {"a": np.zeros(3)})
    write_ply_cloud(
        tmp_path / make_longest_name(".ply"), np.zeros((1, 3), np.float32), np.zeros((1, 3), np.uint8)
    )
    remesh(ball(), levels=1).save(tmp_path / make_longest_name(".snm"))
    assert len(list(tmp_path.iterdir())) == 4
