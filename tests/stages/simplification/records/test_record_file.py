"""Record files contain everything that a replay needs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from collapse_records import KINDS, load_arrays, make_record, save_record

from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.simplification.records.collapse_steps import ReplayedMesh
from scanloom.stages.simplification.records.load import load_record
from scanloom.stages.simplification.records.record import FORMAT_VERSION


def assert_equal(one: ReplayedMesh, other: ReplayedMesh) -> None:
    for name in ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids"):
        np.testing.assert_array_equal(getattr(one.mesh, name), getattr(other.mesh, name))
    np.testing.assert_array_equal(one.vertex_source, other.vertex_source)
    np.testing.assert_array_equal(one.triangle_source, other.triangle_source)
    assert (one.mesh.texture is None) == (other.mesh.texture is None)
    if one.mesh.texture is not None and other.mesh.texture is not None:
        np.testing.assert_array_equal(one.mesh.texture.uvs, other.mesh.texture.uvs)
        np.testing.assert_array_equal(one.mesh.texture.material_ids, other.mesh.texture.material_ids)


@pytest.mark.parametrize("kind", KINDS)
def test_a_record_survives_its_file(tmp_path: Path, kind: str) -> None:
    record, again = make_record(kind), load_record(save_record(kind, tmp_path))
    assert [entry.name for entry in tmp_path.iterdir()] == ["light.npz"]
    assert (record.wedges is not None) == (again.wedges is not None) == (kind == "wedges")
    for collapses in (0, 1, len(record.removed) // 2, len(record.removed)):
        assert_equal(again.replay(collapses=collapses), record.replay(collapses=collapses))
    np.testing.assert_array_equal(again.lock, record.lock)
    if kind != "wedges":
        assert_equal(again.replay(fit=True), record.replay(fit=True))


def test_the_texture_survives(tmp_path: Path) -> None:
    texture, before = (
        load_record(save_record("wedges", tmp_path)).mesh.texture,
        make_record("wedges").mesh.texture,
    )
    assert texture is not None
    assert before is not None
    assert texture.materials[0].name == "sheet"
    np.testing.assert_array_equal(texture.images[0].pixels, before.images[0].pixels)


@pytest.mark.parametrize("kind", ["vertices", "wedges"])
def test_the_file_describes_its_content(tmp_path: Path, kind: str) -> None:
    arrays = load_arrays(save_record(kind, tmp_path))
    about = json.loads(str(arrays["about"]))
    assert arrays["scanloom_collapse_record"] == FORMAT_VERSION == 2
    assert about["content"] == f"collapses of vertices{' and wedges' if kind == 'wedges' else ''}"
    assert about["collapses"] == len(make_record(kind).removed)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_record_gives_the_same_file(tmp_path: Path, kind: str) -> None:
    first = save_record(kind, tmp_path).read_bytes()
    load_record(tmp_path / "light.npz").save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == first


@pytest.mark.parametrize("kind", KINDS)
def test_a_recompressed_file_is_read(tmp_path: Path, kind: str) -> None:
    path = save_record(kind, tmp_path)
    np.savez_compressed(path, **load_arrays(path))
    assert_equal(load_record(path).replay(), make_record(kind).replay())


def test_a_missing_folder_is_reported(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="cannot be written"):
        make_record("vertices").save(tmp_path / "nowhere" / "light.npz")
