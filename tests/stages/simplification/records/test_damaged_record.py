"""Truncated, changed and foreign record files: one error that names the file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from collapse_records import load_arrays, make_record, save_record

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.simplification.records.load import load_record


@pytest.mark.parametrize("kind", ["vertices", "wedges"])
def test_a_truncated_file_is_bad_input(tmp_path: Path, kind: str) -> None:
    path = save_record(kind, tmp_path)
    whole = path.read_bytes()
    for length in (0, 1, 30, 1000, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"light\.npz: is damaged, or not a collapse record"):
            load_record(path)


def test_a_changed_byte_is_bad_input(tmp_path: Path) -> None:
    record, path = make_record("vertices"), save_record("vertices", tmp_path)
    whole = path.read_bytes()
    for array in (record.mesh.vertices, record.mesh.triangles, record.removed, record.survivor, record.path):
        place = whole.index(array.tobytes()) + array.nbytes // 2
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1]) + whole[place + 1 :])
        with pytest.raises(InputError, match=r"light\.npz: is damaged, or not a collapse record"):
            load_record(path)


def test_an_unknown_compression_is_bad_input(tmp_path: Path) -> None:
    path = save_record("vertices", tmp_path)
    content = bytearray(path.read_bytes())
    entry = content.index(
        b"PK\x01\x02"
    )  # in the central directory; its compression method is two bytes at 10
    content[entry + 10] = 99
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or not a collapse record"):
        load_record(path)


def test_other_files_are_not_records(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.npz: cannot be read: No such file"):
        load_record(tmp_path / "missing.npz")
    for name, content in (("a.npz", b"ply\nformat"), ("b.npz", b"\x93NUMPY\x01")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match="is damaged, or not a collapse record"):
            load_record(tmp_path / name)
    np.save(tmp_path / "c.npy", np.arange(3))
    with pytest.raises(InputError, match="not a collapse record"):
        load_record(tmp_path / "c.npy")


def change_arrays(arrays: dict[str, Any], name: str) -> dict[str, Any]:
    """Make one error in the arrays of a record of vertex collapses."""
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
        ("version", "is a record of version 3; this scanloom reads version 2"),
        ("versions", r"is a record of version \[2 2\]; this scanloom reads"),
        ("other", "is not a collapse record"),
        ("missing", "path is missing"),
        ("no words", r"is damaged, or not a collapse record \('about'\)"),
        ("no json", "is damaged, or not a collapse record"),
        ("no object", "the metadata is not a JSON object"),
        ("deep", "is damaged, or not a collapse record"),
        ("type", "removed has type float64 and shape"),
        ("scalar", r"removed has type int32 and shape \(\)"),
        ("length", "survivor has type int32 and shape"),
        ("columns", "path has type float64 and shape"),
        ("range", "survivor refers to a vertex that does not exist"),
        ("finite", "path has positions or colours that are not finite"),
        ("twice", "collapse 2 refers to a vertex that was already removed"),
        ("itself", "collapse 0 refers to a vertex that was already removed"),
        ("gone", "collapse 9 refers to a vertex that was already removed"),
        ("mesh", "triangle .* uses vertices"),
        ("object", "is damaged, or not a collapse record"),
    ],
)
def test_an_inconsistent_record_is_reported(tmp_path: Path, name: str, message: str) -> None:
    path = save_record("vertices", tmp_path)
    np.savez(path, **change_arrays(load_arrays(path), name))
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
    path = save_record("wedges", tmp_path)
    arrays = load_arrays(path)
    whole = arrays.pop(name)
    if damage == "cut":
        # A truncated image is detected when it is decoded.
        arrays[name] = whole[:-1] if name != "mesh/image_0" else whole.astype(np.int32)
    elif damage == "out of range":
        odd = np.nan if whole.dtype.kind == "f" else 10**9 if whole.dtype.kind == "i" else "?"
        arrays[name] = np.full_like(whole, odd, dtype=None if odd != "?" else "U1")
    np.savez(path, **arrays)
    if name == "mesh/uvs" and damage == "missing":
        # Without coordinates, the mesh has no texture.
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
def test_inconsistent_metadata_is_refused(tmp_path: Path, about: dict[str, Any]) -> None:
    path = save_record("wedges", tmp_path)
    arrays = load_arrays(path)
    words = json.loads(str(arrays["about"]))
    for part, changes in about.items():
        words[part] = words[part] | changes if changes and isinstance(changes, dict) else changes
    np.savez(path, **arrays | {"about": np.array(json.dumps(words))})
    with pytest.raises(InputError, match=r"light\.npz: "):
        load_record(path)
