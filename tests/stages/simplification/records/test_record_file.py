"""The file of a record: it holds all that a replay needs, and nothing in it is believed."""

from __future__ import annotations

import functools
import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from seamed_meshes import folded_strips

from stages.errors import InputError, ScanloomError, StageError
from stages.simplification.records.load import load_record
from stages.simplification.records.record import FORMAT_VERSION, CollapseRecord
from stages.simplification.records.steps import Replayed
from stages.simplification.simplify import simplify
from stages.surface.mesh import Mesh

GOLDEN = Path(__file__).parents[3] / "golden"


def ring() -> Mesh:
    made = trimesh.creation.torus(1.0, 0.4, major_sections=32, minor_sections=16)
    vertices = np.array(made.vertices)
    colors = np.clip(128 + 90 * np.sin(5 * vertices), 0, 255).astype(np.uint8)
    return Mesh(vertices, np.array(made.faces, np.int32), colors=colors)


def cut_sheet() -> Mesh:
    mesh = folded_strips(24, 9)
    colors = np.arange(3 * len(mesh.vertices)).reshape(-1, 3) % 256
    normals = np.tile([0.0, 0.0, 1.0], (len(mesh.vertices), 1))
    return mesh.with_(colors=colors.astype(np.uint8), normals=normals)


@functools.cache
def recorded(kind: str) -> CollapseRecord:
    mesh = ring()
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1)[:, None]
    match kind:
        case "vertices":
            result = simplify(mesh, ratio=0.1, lock=[3, 4], record=True)
        case "no colours":
            result = simplify(mesh.with_(colors=None, normals=normals), ratio=0.1, record=True)
        case "split":
            result = simplify(mesh, method="jia01", max_shape=0.05, resolution=0.15, record=True)
        case _:
            result = simplify(cut_sheet(), method="seams", ratio=0.1, record=True)
    assert result.record is not None
    return result.record


KINDS = ["vertices", "no colours", "split", "wedges"]


def saved(kind: str, folder: Path) -> Path:
    recorded(kind).save(folder / "light.npz")
    return folder / "light.npz"


def arrays_of(path: Path) -> dict[str, Any]:
    with np.load(path) as content:
        return dict(content)


def assert_equal(one: Replayed, other: Replayed) -> None:
    for name in ("vertices", "triangles", "colors", "normals", "corner_normals", "part_ids"):
        np.testing.assert_array_equal(getattr(one.mesh, name), getattr(other.mesh, name))
    np.testing.assert_array_equal(one.vertex_source, other.vertex_source)
    np.testing.assert_array_equal(one.triangle_source, other.triangle_source)
    assert (one.mesh.texture is None) == (other.mesh.texture is None)
    if one.mesh.texture is not None and other.mesh.texture is not None:
        np.testing.assert_array_equal(one.mesh.texture.uvs, other.mesh.texture.uvs)
        np.testing.assert_array_equal(one.mesh.texture.material_ids, other.mesh.texture.material_ids)


# -- whole files -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_a_record_survives_its_file(tmp_path: Path, kind: str) -> None:
    record, again = recorded(kind), load_record(saved(kind, tmp_path))
    assert [entry.name for entry in tmp_path.iterdir()] == ["light.npz"]
    assert (record.wedges is not None) == (again.wedges is not None) == (kind == "wedges")
    for collapses in (0, 1, len(record.removed) // 2, len(record.removed)):
        assert_equal(again.replay(collapses=collapses), record.replay(collapses=collapses))
    np.testing.assert_array_equal(again.lock, record.lock)
    if kind != "wedges":
        assert_equal(again.replay(fit=True), record.replay(fit=True))


def test_the_texture_survives(tmp_path: Path) -> None:
    texture, before = load_record(saved("wedges", tmp_path)).mesh.texture, recorded("wedges").mesh.texture
    assert texture is not None
    assert before is not None
    assert texture.materials[0].name == "sheet"
    np.testing.assert_array_equal(texture.images[0].pixels, before.images[0].pixels)


@pytest.mark.parametrize("kind", ["vertices", "wedges"])
def test_the_file_says_what_it_holds(tmp_path: Path, kind: str) -> None:
    arrays = arrays_of(saved(kind, tmp_path))
    about = json.loads(str(arrays["about"]))
    assert arrays["scanloom_collapse_record"] == FORMAT_VERSION == 2
    assert about["content"] == f"collapses of vertices{' and wedges' if kind == 'wedges' else ''}"
    assert about["collapses"] == len(recorded(kind).removed)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_record_is_the_same_file(tmp_path: Path, kind: str) -> None:
    first = saved(kind, tmp_path).read_bytes()
    load_record(tmp_path / "light.npz").save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == first


@pytest.mark.parametrize("kind", KINDS)
def test_a_file_that_somebody_packed_still_reads(tmp_path: Path, kind: str) -> None:
    path = saved(kind, tmp_path)
    np.savez_compressed(path, **arrays_of(path))
    assert_equal(load_record(path).replay(), recorded(kind).replay())


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(StageError, match="cannot be written"):
        recorded("vertices").save(tmp_path / "nowhere" / "light.npz")


# -- damaged files ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["vertices", "wedges"])
def test_a_file_cut_short_anywhere_is_bad_input(tmp_path: Path, kind: str) -> None:
    path = saved(kind, tmp_path)
    whole = path.read_bytes()
    for length in (0, 1, 30, 1000, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
            load_record(path)


def test_a_changed_byte_is_bad_input(tmp_path: Path) -> None:
    record, path = recorded("vertices"), saved("vertices", tmp_path)
    whole = path.read_bytes()
    for array in (record.mesh.vertices, record.mesh.triangles, record.removed, record.survivor, record.path):
        place = whole.index(array.tobytes()) + array.nbytes // 2
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
            load_record(path)


def test_an_archive_nobody_wrote_like_this_is_bad_input(tmp_path: Path) -> None:
    path = saved("vertices", tmp_path)
    content = bytearray(path.read_bytes())
    entry = content.index(b"PK\x01\x02")  # in the archive's directory; its compression is two bytes at 10
    content[entry + 10] = 99
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
        load_record(path)


def test_other_files_are_no_records(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.npz: cannot be read: No such file"):
        load_record(tmp_path / "missing.npz")
    for name, content in (("a.npz", b"ply\nformat"), ("b.npz", b"\x93NUMPY\x01")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="is damaged, or no record"):
            load_record(tmp_path / name)
    np.save(tmp_path / "c.npy", np.arange(3))
    with pytest.raises(InputError, match="no record of collapses"):
        load_record(tmp_path / "c.npy")


def changed(arrays: dict[str, Any], name: str) -> dict[str, Any]:
    """Arrays of a file of collapses of vertices with one thing wrong."""
    removed, survivor, path = (arrays[key].copy() for key in ("removed", "survivor", "path"))
    match name:
        case "version":
            return arrays | {"scanloom_collapse_record": np.array(3)}
        case "versions":
            return arrays | {"scanloom_collapse_record": np.array([2, 2])}
        case "other":
            del arrays["scanloom_collapse_record"]
        case "missing":
            del arrays["path"]
        case "no words":
            del arrays["about"]
        case "no json":
            return arrays | {"about": np.array("{")}
        case "no object":
            return arrays | {"about": np.array("[1, 2]")}
        case "deep":
            return arrays | {"about": np.array("[" * 100_000)}
        case "type":
            return arrays | {"removed": removed.astype(np.float64)}
        case "scalar":
            return arrays | {"removed": np.array(3, np.int32)}
        case "length":
            return arrays | {"survivor": survivor[:-1]}
        case "columns":
            return arrays | {"path": path[:, :3]}
        case "range":
            survivor[5] = len(arrays["mesh/vertices"])
        case "finite":
            path[5, 1] = np.nan
        case "twice":
            removed[9] = removed[2]
        case "itself":
            survivor[0] = removed[0]
        case "gone":
            survivor[9] = removed[2]
        case "mesh":
            return arrays | {"mesh/triangles": arrays["mesh/triangles"] + 1}
        case "object":
            return arrays | {"lock": np.array([None, 1], object)}
    return arrays | {"removed": removed, "survivor": survivor} | ({"path": path} if "path" in arrays else {})


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("version", "is a record of version 3; this scanloom reads versions 1 and 2"),
        ("versions", r"is a record of version \[2 2\]; this scanloom reads"),
        ("other", "is no record of collapses"),
        ("missing", "it has no path"),
        ("no words", r"is damaged, or no record of collapses \('about'\)"),
        ("no json", "is damaged, or no record of collapses"),
        ("no object", "a text is no JSON object"),
        ("deep", "is damaged, or no record of collapses"),
        ("type", "removed is float64 of shape"),
        ("scalar", r"removed is int32 of shape \(\)"),
        ("length", "survivor is int32 of shape"),
        ("columns", "path is float64 of shape"),
        ("range", "survivor names a vertex that is not there"),
        ("finite", "a vertex goes to a place that is not finite"),
        ("twice", "collapse 2 has a vertex that is gone already"),
        ("itself", "collapse 0 has a vertex that is gone already"),
        ("gone", "collapse 9 has a vertex that is gone already"),
        ("mesh", "triangle .* uses vertices"),
        ("object", "is damaged, or no record"),
    ],
)
def test_a_record_that_cannot_be_is_named(tmp_path: Path, name: str, message: str) -> None:
    path = saved("vertices", tmp_path)
    arrays = arrays_of(path)
    damaged = (
        changed(dict(arrays), name) if name != "missing" else {k: arrays[k] for k in arrays if k != "path"}
    )
    np.savez(path, **damaged)
    with pytest.raises(InputError, match=rf"light\.npz: .*{message}"):
        load_record(path)


@pytest.mark.parametrize(
    "name",
    [
        *("removed", "survivor", "path", "lock", "wedges/origin", "wedges/positions", "wedges/columns"),
        *("wedges/removed", "wedges/survivor", "wedges/when", "wedges/corner_wedge", "wedges/corner_vertex"),
        *("wedges/changed", "wedges/changed_to", "wedges/changed_source", "wedges/changed_when"),
        *("mesh/vertices", "mesh/triangles", "mesh/uvs", "mesh/material_ids", "mesh/image_0"),
    ],
)
@pytest.mark.parametrize("damage", ["missing", "cut", "out of range"])
def test_a_damaged_array_is_refused(tmp_path: Path, name: str, damage: str) -> None:
    path = saved("wedges", tmp_path)
    arrays = arrays_of(path)
    whole = arrays.pop(name)
    if damage == "cut":
        # An image cut short is noticed where it is decoded.
        arrays[name] = whole[:-1] if name != "mesh/image_0" else whole.astype(np.int32)
    elif damage == "out of range":
        odd = np.nan if whole.dtype.kind == "f" else 10**9 if whole.dtype.kind == "i" else "?"
        arrays[name] = np.full_like(whole, odd, dtype=None if odd != "?" else "U1")
    np.savez(path, **arrays)
    if name == "mesh/uvs" and damage == "missing":
        # That is a mesh without texture.
        assert load_record(path).replay().mesh.texture is None
    else:
        with pytest.raises(InputError, match=r"light\.npz: "):
            load_record(path)


@pytest.mark.parametrize(
    "about",
    [
        {"mesh": {}},
        {"mesh": None},
        {"wedges": {}},
        {"wedges": 3},
        {"wedges": {"uv_scale": 10**400}},
        {"wedges": {"uv_scale": 0}},
        {"wedges": {"color_scale": float("nan")}},
        {"wedges": {"has_colors": False}},
        {"mesh": {"images": []}},
        {"mesh": {"materials": [["sheet", 7, None, ["repeat", "repeat"]]]}},
        {"mesh": {"materials": [["sheet", 0, None, ["sideways", "repeat"]]]}},
        {"mesh": {"materials": [["sheet", 0, [1, 2], ["repeat", "repeat"]]]}},
        {"mesh": {"materials": [["sheet"]]}},
    ],
)
def test_words_that_cannot_be_are_refused(tmp_path: Path, about: dict[str, Any]) -> None:
    path = saved("wedges", tmp_path)
    arrays = arrays_of(path)
    words = json.loads(str(arrays["about"]))
    for part, changes in about.items():
        words[part] = words[part] | changes if changes and isinstance(changes, dict) else changes
    np.savez(path, **arrays | {"about": np.array(json.dumps(words))})
    with pytest.raises(InputError, match=r"light\.npz: "):
        load_record(path)


# -- hostile files ---------------------------------------------------------------------------------------


def header(shape: tuple[int, ...], kind: str) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": kind, "fortran_order": False, "shape": shape})
    return content.getvalue()


@pytest.mark.parametrize(
    ("shape", "kind"),
    [((2**40, 3), "<f8"), ((2**40, 0), "<f8"), ((2**62,), "<U0"), ((2**62,), "|V0"), ((-1,), "<f8")],
)
def test_no_room_is_made_for_what_is_only_promised(tmp_path: Path, shape: tuple[int, ...], kind: str) -> None:
    path = saved("vertices", tmp_path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("other.npy", header(shape, kind) + bytes(64))
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
        load_record(path)


@pytest.mark.parametrize(
    "words",
    [
        "Z'descr': '<f8', 'shape': (3, 3), }",
        "  {\n 'descr'\n",
        "{[]: 3}",
        "(" * 5000,
        "{'descr': '<f8', 'fortran_order': 3, 'shape': 'a'}",
        "{'descr': [(3,)], 'fortran_order': True, 'shape': (3,)}",
    ],
)
def test_first_lines_that_are_none_are_refused(tmp_path: Path, words: str) -> None:
    path = saved("vertices", tmp_path)
    first = words.encode() + b"\n"
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(
            "other.npy", b"\x93NUMPY\x01\x00" + len(first).to_bytes(2, "little") + first + bytes(64)
        )
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
        load_record(path)


def test_an_archive_that_unpacks_a_thousandfold_is_not_unpacked(tmp_path: Path) -> None:
    path = saved("vertices", tmp_path)
    np.savez_compressed(path, **arrays_of(path), other=np.zeros(50_000_000, np.uint8))
    with pytest.raises(InputError, match=r"light\.npz: .*would unpack to far more than it is"):
        load_record(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_no_other_compression_is_unpacked(tmp_path: Path, method: int) -> None:
    path = saved("vertices", tmp_path)
    with zipfile.ZipFile(path, "a", method) as archive:
        archive.writestr("other.npy", header((1000,), "|u1") + bytes(1000))
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or no record"):
        load_record(path)


def test_a_truth_value_is_0_or_1_whatever_the_byte(tmp_path: Path) -> None:
    path = saved("vertices", tmp_path)
    arrays = arrays_of(path)
    np.savez(path, **arrays | {"lock": (arrays["lock"] * np.uint8(254)).view(bool)})
    assert set(load_record(path).lock.view(np.uint8).tolist()) == {0, 1}


def test_a_tall_forest_replays(tmp_path: Path) -> None:
    """A strip whose vertices go one into the next: each triangle meets its end after a long way."""
    count = 100_000
    steps = np.arange(count - 1, dtype=np.int32)
    vertices = np.zeros((count, 3))
    vertices[:, 0] = np.arange(count)
    ends = np.stack([steps[:-1], steps[:-1] + 1, np.full(count - 2, count - 1, np.int32)], axis=1)
    mesh = Mesh(vertices, ends.astype(np.int32))
    CollapseRecord(mesh, steps, steps + 1, vertices[1:], np.zeros(count, bool)).save(tmp_path / "tall.npz")
    record = load_record(tmp_path / "tall.npz")
    assert record.triangles_after(0) == count - 2
    assert record.triangles_after(1) == count - 3
    assert len(record.replay(collapses=count - 10).mesh.triangles) == 8


FILES = [*KINDS, *(f"record_1_{name}" for name in ("quadric", "jia01", "seams"))]


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(FILES), seed=st.integers(0, 2**32 - 1))
def test_any_numbers_are_refused_or_replay(tmp_path: Path, kind: str, seed: int) -> None:
    """Bytes of arrays changed at random, in an archive that is whole."""
    rng = np.random.default_rng(seed)
    path = GOLDEN / f"{kind}.npz" if kind not in KINDS else saved(kind, tmp_path)
    arrays = arrays_of(path)
    names = sorted(name for name, array in arrays.items() if array.dtype.kind in "iufb" and array.size)
    for name in rng.choice(names, int(rng.integers(1, 3))):
        array = arrays[name].copy().reshape(-1)
        places = rng.integers(0, len(array), int(rng.integers(1, 4)))
        if array.dtype.kind == "i" and rng.random() < 0.7:
            array[places] = array[rng.integers(0, len(array), len(places))]
        else:
            byte = places * array.itemsize + rng.integers(0, array.itemsize, len(places))
            array.view(np.uint8)[byte] ^= np.uint8(1) << rng.integers(0, 8, len(places), np.uint8)
        arrays[name] = array.reshape(arrays[name].shape)
    np.savez(tmp_path / "odd.npz", **arrays)
    try:
        record = load_record(tmp_path / "odd.npz")
        for collapses in (0, len(record.removed) // 2, len(record.removed)):
            with np.errstate(all="ignore"):
                record.replay(collapses=collapses, fit=record.wedges is None)
    except ScanloomError as error:
        assert "\n" not in str(error)  # noqa: PT017 (that it is raised is not wanted)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(FILES), seed=st.integers(0, 2**32 - 1))
def test_any_bytes_are_refused_or_replay(tmp_path: Path, kind: str, seed: int) -> None:
    """Bytes of the file changed at random, of the archive's own above all: its headers and directory."""
    rng = np.random.default_rng(seed)
    path = GOLDEN / f"{kind}.npz" if kind not in KINDS else saved(kind, tmp_path)
    content = bytearray(path.read_bytes())
    starts = [
        i for mark in (b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06", b"\x93NUMPY") for i in _all(content, mark)
    ]
    for _ in range(int(rng.integers(1, 4))):
        at = min(int(rng.choice(starts)) + int(rng.integers(0, 128)), len(content) - 1)
        content[at] = int(rng.integers(0, 256))
    (tmp_path / "odd.npz").write_bytes(content)
    try:
        load_record(tmp_path / "odd.npz").replay()
    except ScanloomError as error:
        assert "\n" not in str(error)  # noqa: PT017


def _all(content: bytearray, mark: bytes) -> list[int]:
    found, at = [], content.find(mark)
    while at >= 0:
        found.append(at)
        at = content.find(mark, at + 1)
    return found
