"""Archives: stated sizes and methods of entries are checked before decompression."""

from __future__ import annotations

import tracemalloc
import zipfile
from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.zip_archives import open_archive, read_entry

BIG = 50_000_000


def write_archive(folder: Path, data: bytes, method: int) -> Path:
    path = folder / "a.zip"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("x", data)
    return path


def understate_size(path: Path, size: int) -> None:
    """Set both stored sizes of the only entry of an archive to `size` bytes."""
    data = bytearray(path.read_bytes())
    listed = data.rindex(b"PK\1\2")
    data[22:26] = data[listed + 24 : listed + 28] = size.to_bytes(4, "little")
    path.write_bytes(data)


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_stored_and_deflated_entries_are_read(tmp_path: Path, method: int) -> None:
    path = write_archive(tmp_path, b"abc" * 100, method)
    assert read_entry(open_archive(path), "x", path, 300) == b"abc" * 100


@pytest.mark.parametrize("method", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_an_entry_above_the_limit_is_refused(tmp_path: Path, method: int) -> None:
    path = write_archive(tmp_path, b"abc" * 100, method)
    with pytest.raises(InputError, match=r"a\.zip: x is too large: it has 300 bytes, and at most 299"):
        read_entry(open_archive(path), "x", path, 299)


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
@pytest.mark.parametrize("says_so", [True, False])
def test_unbounded_methods_are_refused_before_decompression(
    tmp_path: Path, method: int, says_so: bool
) -> None:
    """A few kilobytes of bzip2 decompressed to gigabytes before the size was checked."""
    path = write_archive(tmp_path, bytes(BIG), method)
    if not says_so:
        understate_size(path, 100)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.zip: x has an unsupported compression method; .* deflate"):
        read_entry(open_archive(path), "x", path, 2 * BIG)
    assert tracemalloc.get_traced_memory()[1] < BIG / 10
    tracemalloc.stop()


def test_a_deflated_entry_larger_than_stated_is_damaged(tmp_path: Path) -> None:
    path = write_archive(tmp_path, bytes(BIG), zipfile.ZIP_DEFLATED)
    understate_size(path, 100)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.zip: x cannot be read from the archive; it is damaged"):
        read_entry(open_archive(path), "x", path, BIG)
    assert tracemalloc.get_traced_memory()[1] < BIG / 10
    tracemalloc.stop()


def test_missing_archives_and_entries_are_reported(tmp_path: Path) -> None:
    path = write_archive(tmp_path, b"abc", zipfile.ZIP_STORED)
    with pytest.raises(InputError, match=r"a\.zip: y cannot be read from the archive"):
        read_entry(open_archive(path), "y", path, 3)
    path.write_bytes(path.read_bytes()[:-30])
    with pytest.raises(InputError, match=r"a\.zip: the archive does not open"):
        open_archive(path)
    with pytest.raises(InputError, match=r"the archive does not open"):
        open_archive(tmp_path)
