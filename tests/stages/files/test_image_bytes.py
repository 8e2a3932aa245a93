"""Image sizes in headers are checked before decoding."""

from __future__ import annotations

import io
import struct
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.image_bytes import decode_image, encode_png
from scanloom.stages.files.image_headers import read_header_size
from scanloom.stages.files.images import read_image_size, read_stored_image

SMALL = np.full((3, 5, 3), 7, np.uint8)


def make_png(width: int, height: int) -> bytes:
    """Make a PNG whose header states another size than its pixels."""
    data = bytearray(encode_png(SMALL))
    data[16:24] = struct.pack(">2I", width, height)
    data[29:33] = struct.pack(">I", zlib.crc32(data[12:29]))
    return bytes(data)


def make_tiff(width: int, height: int) -> bytes:
    held = io.BytesIO()
    Image.fromarray(SMALL).save(held, "TIFF")
    data = bytearray(held.getvalue())
    (start,) = struct.unpack_from("<I", data, 4)
    (count,) = struct.unpack_from("<H", data, start)
    for at in range(start + 2, start + 2 + 12 * count, 12):
        tag = struct.unpack_from("<H", data, at)[0]
        if tag in (256, 257):
            struct.pack_into("<HII", data, at + 2, 4, 1, width if tag == 256 else height)
    return bytes(data)


@pytest.mark.parametrize("make", [make_png, make_tiff])
def test_sizes_are_read_from_the_header(make) -> None:
    assert read_header_size(make(5, 3)) == (5, 3)
    assert read_header_size(make(50_000, 40_000)) == (50_000, 40_000)


@pytest.mark.parametrize("make", [make_png, make_tiff])
@pytest.mark.parametrize("size", [(5, 0), (0, 3), (0, 0), (60_000, 60_000)])
def test_impossible_sizes_are_refused(tmp_path: Path, make, size: tuple[int, int]) -> None:
    """A height of 0 led to a division by zero."""
    path = tmp_path / "a.png"
    path.write_bytes(make(*size))
    for read in (read_image_size, read_stored_image):
        with pytest.raises(InputError, match=r"a\.png: (its header is damaged|the image does not decode)"):
            read(path)
    assert decode_image(make(*size)) is None


def test_a_png_chunk_that_claims_gigabytes_allocates_no_memory() -> None:
    data = bytearray(encode_png(SMALL))
    at = data.index(b"IDAT") - 4
    data[at : at + 4] = (0x7FFFFFF0).to_bytes(4, "big")
    assert decode_image(bytes(data)) is None
