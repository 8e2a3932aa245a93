"""Malicious record files: no crash, no hang, and no memory for content that does not exist."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from collapse_records import KINDS, load_arrays, save_record
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import InputError, ScanloomError
from scanloom.stages.simplification.records.load import load_record
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.surface.mesh import Mesh


def make_header(shape: tuple[int, ...], kind: str) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array_header_1_0(content, {"descr": kind, "fortran_order": False, "shape": shape})
    return content.getvalue()


@pytest.mark.parametrize(
    ("shape", "kind"),
    [((2**40, 3), "<f8"), ((2**40, 0), "<f8"), ((2**62,), "<U0"), ((2**62,), "|V0"), ((-1,), "<f8")],
)
def test_no_memory_is_allocated_for_stated_sizes(tmp_path: Path, shape: tuple[int, ...], kind: str) -> None:
    path = save_record("vertices", tmp_path)
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("other.npy", make_header(shape, kind) + bytes(64))
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or not a collapse record"):
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
def test_malformed_array_headers_are_refused(tmp_path: Path, words: str) -> None:
    path = save_record("vertices", tmp_path)
    first = words.encode() + b"\n"
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr(
            "other.npy", b"\x93NUMPY\x01\x00" + len(first).to_bytes(2, "little") + first + bytes(64)
        )
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or not a collapse record"):
        load_record(path)


def test_an_archive_with_a_huge_compression_ratio_is_not_decompressed(tmp_path: Path) -> None:
    path = save_record("vertices", tmp_path)
    np.savez_compressed(path, **load_arrays(path), other=np.zeros(50_000_000, np.uint8))
    with pytest.raises(InputError, match=r"light\.npz: .*would unpack to many times its size"):
        load_record(path)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression_methods_are_refused(tmp_path: Path, method: int) -> None:
    path = save_record("vertices", tmp_path)
    with zipfile.ZipFile(path, "a", method) as archive:
        archive.writestr("other.npy", make_header((1000,), "|u1") + bytes(1000))
    with pytest.raises(InputError, match=r"light\.npz: is damaged, or not a collapse record"):
        load_record(path)


def test_any_nonzero_byte_is_read_as_true(tmp_path: Path) -> None:
    path = save_record("vertices", tmp_path)
    arrays = load_arrays(path)
    np.savez(path, **arrays | {"lock": (arrays["lock"] * np.uint8(254)).view(bool)})
    assert set(load_record(path).lock.view(np.uint8).tolist()) == {0, 1}


def test_a_long_chain_of_collapses_replays(tmp_path: Path) -> None:
    """In this strip each vertex collapses into the next, so each triangle vanishes after a long chain."""
    count = 100_000
    steps = np.arange(count - 1, dtype=np.int32)
    vertices = np.zeros((count, 3))
    vertices[:, 0] = np.arange(count)
    ends = np.stack([steps[:-1], steps[:-1] + 1, np.full(count - 2, count - 1, np.int32)], axis=1)
    mesh = Mesh(vertices, ends.astype(np.int32))
    CollapseRecord(mesh, steps, steps + 1, vertices[1:], np.zeros(count, bool)).save(tmp_path / "tall.npz")
    record = load_record(tmp_path / "tall.npz")
    assert record.count_triangles_after(0) == count - 2
    assert record.count_triangles_after(1) == count - 3
    assert len(record.replay(collapses=count - 10).mesh.triangles) == 8


@pytest.mark.slow
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(list(KINDS)), seed=st.integers(0, 2**32 - 1))
def test_random_values_are_refused_or_replayed(tmp_path: Path, kind: str, seed: int) -> None:
    """Random bytes of arrays are changed, in a valid archive."""
    rng = np.random.default_rng(seed)
    path = save_record(kind, tmp_path)
    arrays = load_arrays(path)
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
        assert "\n" not in str(error)  # noqa: PT017 - an error is permitted, not required


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(kind=st.sampled_from(list(KINDS)), seed=st.integers(0, 2**32 - 1))
def test_random_bytes_are_refused_or_replayed(tmp_path: Path, kind: str, seed: int) -> None:
    """Random bytes of the file are changed, mostly in headers and directory of the archive."""
    rng = np.random.default_rng(seed)
    path = save_record(kind, tmp_path)
    content = bytearray(path.read_bytes())
    starts = [
        i
        for mark in (b"PK\x03\x04", b"PK\x01\x02", b"PK\x05\x06", b"\x93NUMPY")
        for i in _find_all(content, mark)
    ]
    for _ in range(int(rng.integers(1, 4))):
        at = min(int(rng.choice(starts)) + int(rng.integers(0, 128)), len(content) - 1)
        content[at] = int(rng.integers(0, 256))
    (tmp_path / "odd.npz").write_bytes(content)
    try:
        load_record(tmp_path / "odd.npz").replay()
    except ScanloomError as error:
        assert "\n" not in str(error)  # noqa: PT017


def _find_all(content: bytearray, mark: bytes) -> list[int]:
    found, at = [], content.find(mark)
    while at >= 0:
        found.append(at)
        at = content.find(mark, at + 1)
    return found
