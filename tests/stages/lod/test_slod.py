"""SLOD files: round trips, prefixes as coarse models, and one error for damage."""

from __future__ import annotations

import json
import struct
import zlib
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from scanloom.stages import InputError, Mesh, lod
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.lod import Hierarchy
from tests.made.coloured_meshes import assert_same_topology, sheet

Built = tuple[Mesh, Hierarchy]


@pytest.fixture
def file(built: Built, tmp_path: Path) -> Path:
    lod.write_slod(tmp_path / "m.slod", built[1])
    return tmp_path / "m.slod"


def test_a_hierarchy_is_read_as_written(built: Built, file: Path) -> None:
    read = lod.read_slod(file)
    for field in fields(Hierarchy):
        ours, theirs = getattr(built[1], field.name), getattr(read, field.name)
        if isinstance(ours, np.ndarray):
            assert ours.dtype == theirs.dtype
            np.testing.assert_array_equal(ours, theirs)
        else:
            assert ours == theirs


@pytest.mark.parametrize("up", [(0.0, -1.0, 0.0), (0.6, 0.0, 0.8)])
def test_the_up_direction_is_stored_and_passed_to_cuts(
    tmp_path: Path, up: tuple[float, float, float]
) -> None:
    asked = {"cell_triangles": 200, "root_triangles": 50}
    hierarchy = lod.build(sheet(20).with_(up=up), **asked)
    path = tmp_path / "m.slod"
    lod.write_slod(path, hierarchy)
    read = lod.read_slod(path)
    assert read.up == hierarchy.up == read.to_dict()["up"] == up
    assert read.cut(triangles=100).mesh.up == up
    lod.write_slod(path, lod.build(sheet(20), **asked))
    assert lod.read_slod(path).up is None
    assert b'"up"' not in path.read_bytes()


@pytest.mark.parametrize(
    "up", ["up", [0, 1], [0.0, 0.0, 0.0], [1.0, 1.0, 0.0], [True, 0.0, 0.0], [1e400, 0.0, 0.0], None]
)
def test_an_invalid_up_direction_is_damage(file: Path, up: object) -> None:
    _replace_in_tree(file, up=up)
    with pytest.raises(InputError, match="is not a direction"):
        lod.read_slod(file)


def _replace_in_tree(file: Path, **changes: object) -> None:
    data = file.read_bytes()
    size = struct.unpack_from("<Q", data, 8)[0]
    text = json.dumps({**json.loads(data[20 : 20 + size]), **changes}).encode()
    file.write_bytes(
        struct.pack("<4sIQI", b"SLOD", 2, len(text), zlib.crc32(text)) + text + data[20 + size :]
    )


def test_diagnostics_of_the_mesh_are_stored(tmp_path: Path) -> None:
    mesh = sheet(20)
    hierarchy = lod.build(mesh.with_(normals=np.tile((0.0, 0.0, 1.0), (len(mesh.vertices), 1))))
    assert [str(one) for one in hierarchy.diagnostics] == ["lod drops these attributes of the mesh: normals."]
    lod.write_slod(tmp_path / "m.slod", hierarchy)
    with collecting() as found:
        read = lod.read_slod(tmp_path / "m.slod")
    assert read.diagnostics == hierarchy.diagnostics
    assert found == []


@pytest.mark.parametrize(
    "diagnostics",
    [
        None,
        ["text"],
        [{"code": "a.b", "message": "text"}],
        [{"code": "a.b", "severity": "odd", "message": "text"}],
        [{"code": "a.b", "severity": "info", "message": 5}],
        [{"code": "a.b", "severity": "info", "message": "text", "values": []}],
        [{"code": "a.b", "severity": "info", "message": "text", "where": {"row": "1"}}],
    ],
)
def test_a_malformed_diagnostic_is_damage(file: Path, diagnostics: object) -> None:
    _replace_in_tree(file, diagnostics=diagnostics)
    with pytest.raises(InputError, match="is damaged"):
        lod.read_slod(file)


def test_single_precision_is_used_if_it_is_lossless(tmp_path: Path) -> None:
    mesh = sheet(20)
    rounded = mesh.with_(vertices=mesh.vertices.astype(np.float32).astype(np.float64))
    sizes = []
    for i, each in enumerate((mesh, rounded)):
        lod.write_slod(tmp_path / f"{i}.slod", lod.build(each, cell_triangles=200, root_triangles=50))
        sizes.append((tmp_path / f"{i}.slod").stat().st_size)
        read = lod.read_slod(tmp_path / f"{i}.slod")
        assert {tuple(v) for v in each.vertices} <= {tuple(v) for v in read.vertices}
    assert sizes[1] < sizes[0]


def test_every_prefix_is_a_coarse_model(built: Built, file: Path) -> None:
    mesh, hierarchy = built
    data = file.read_bytes()
    read = set()
    for end in np.linspace(len(data) // 8, len(data) - 1, 12).astype(int):
        file.write_bytes(data[:end])
        try:
            part = lod.read_slod(file)
        except InputError:
            continue
        read.add(part.nodes)
        assert part.nodes < hierarchy.nodes
        assert "finer levels are missing" in str(part.diagnostics[-1])
        finest = part.cut(triangles=10**9)
        assert_same_topology(finest.mesh, mesh)
        assert finest.shape_bound_m >= 0
    assert len(read) > 4


def test_damage_is_one_error_or_a_coarser_model(file: Path) -> None:
    data = file.read_bytes()
    random = np.random.default_rng(5)
    messages = []
    for _ in range(300):
        damaged = bytearray(data)
        for _ in range(int(random.integers(1, 4))):
            damaged[int(random.integers(len(data)))] = int(random.integers(256))
        file.write_bytes(bytes(damaged))
        try:
            lod.read_slod(file).cut(triangles=500)
        except InputError as error:
            messages.append(str(error))
    assert messages
    assert all(sentence.startswith(str(file)) and "\n" not in sentence for sentence in messages)


def replace_in_tree(data: bytes, **changes: object) -> bytes:
    """Return a file with changed tree entries and a valid checksum."""
    size = struct.unpack_from("<Q", data, 8)[0]
    tree = json.loads(data[20 : 20 + size])
    for name, value in changes.items():
        (tree["nodes"] if name in tree["nodes"] else tree)[name] = value
    text = json.dumps(tree).encode()
    return struct.pack("<4sIQI", b"SLOD", 2, len(text), zlib.crc32(text)) + text + data[20 + size :]


def test_a_tree_with_false_entries_is_refused(file: Path) -> None:
    data = file.read_bytes()
    nodes = lod.read_slod(file).nodes
    for changes in (
        {"parent": [-1] + [nodes] * (nodes - 1)},
        {"parent": [0] * nodes},
        {"parent": []},
        {"coarse": [7] * nodes},
        {"splits": [2**40] * nodes},
        {"vertices": [-1] * nodes},
        {"triangles": "many"},
        {"shape_bound": [-1.0] * nodes},
        {"shape_bound": [float("nan")] * nodes},
        {"roots": 3},
        {"roots": True},
        {"coordinates": "float16"},
        {"nodes": None},
    ):
        file.write_bytes(replace_in_tree(data, **changes))
        with pytest.raises(InputError, match=r"damaged|not whole"):
            lod.read_slod(file)


def test_other_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "m.slod"
    for content, words in (
        (b"", "not a .slod"),
        (b"ply\n" * 9, "not a .slod"),
        (b"SLOD" + b"\2" * 16, "version"),
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=words):
            lod.read_slod(path)
    with pytest.raises(InputError):
        lod.read_slod(tmp_path / "none.slod")
