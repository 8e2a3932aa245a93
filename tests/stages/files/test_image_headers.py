"""The content of an image selects its decoder, and its header is checked first."""

from __future__ import annotations

import contextlib
import io
import random
import struct
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.image_bytes import decode_image
from scanloom.stages.files.image_headers import detect_image_format, read_header_size
from scanloom.stages.files.images import (
    decode_color,
    decode_depth,
    read_alpha,
    read_image_size,
    read_raw_depth,
    read_stored_image,
)
from scanloom.stages.surface.mesh_files import read_mesh

PIXELS = np.random.default_rng(1).integers(0, 255, (3, 5, 3), np.uint8)
DECODED = ("PNG", "JPEG", "BMP", "GIF", "TIFF", "WEBP", "TGA", "PPM")
REFUSED = ("EPS", "AVIF", "BLP", "DDS", "IM", "JPEG2000", "PCX", "SGI", "ICO", "MSP", "XBM", "PDF")


def encode_image(kind: str, pixels: np.ndarray[Any, Any] = PIXELS) -> bytes:
    if kind == "IM":  # The writer of this format is deprecated.
        return b"Image type: L image\r\nImage size (x*y): 5*3\r\nFile size (no of images): 1\r\n".ljust(
            600, b"\x1a"
        )
    out = io.BytesIO()
    image = Image.fromarray(pixels)
    if kind in ("MSP", "XBM"):
        image = image.convert("1")
    if kind == "BLP":
        image = image.convert("P")
    try:
        image.save(out, kind)
    except (KeyError, OSError) as error:
        pytest.skip(f"this Pillow does not write {kind}: {error}")
    return out.getvalue()


def make_huge_jpeg_2000(width: int, height: int) -> bytes:
    """Make a codestream of some hundred bytes that states this size as one tile."""
    data = bytearray(encode_image("JPEG2000"))
    at = data.index(b"\xff\x51") + 6
    struct.pack_into(">8I", data, at, width, height, 0, 0, width, height, 0, 0)
    return bytes(data)


@pytest.fixture(autouse=True)
def no_program_starts(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*words: object, **_: object) -> None:
        pytest.fail(f"an image started {words}")

    monkeypatch.setattr(subprocess, "Popen", refuse)


@pytest.mark.parametrize("kind", DECODED)
def test_formats_are_decoded_by_their_content(kind: str) -> None:
    data = encode_image(kind)
    assert read_header_size(data, "a.tga") == (5, 3)
    pixels = decode_image(data, "a.tga")
    assert pixels is not None
    if kind not in ("JPEG", "WEBP", "GIF"):
        np.testing.assert_array_equal(pixels[..., :3], PIXELS)


@pytest.mark.parametrize("kind", REFUSED)
@pytest.mark.parametrize("name", ["a.tga", "a.png", "a.jpg"])
def test_other_formats_reach_no_decoder(tmp_path: Path, kind: str, name: str) -> None:
    """EPS started Ghostscript; AVIF, BLP, DDS and IM raised errors of the decoder."""
    data = encode_image(kind)
    assert detect_image_format(data, name) == ""
    assert decode_image(data, name) is None
    path = tmp_path / name
    path.write_bytes(data)
    readers: tuple[Callable[[], object], ...] = (
        lambda: read_image_size(path),
        lambda: read_stored_image(path),
        lambda: read_raw_depth(path),
        lambda: read_alpha(path),
        lambda: decode_color(data, name),
        lambda: decode_depth(data, name),
    )
    for read in readers:
        with pytest.raises(InputError, match=r"not supported; convert|unknown format"):
            read()
    (tmp_path / "a.mtl").write_text(f"newmtl m\nmap_Kd {name}\n")
    (tmp_path / "a.obj").write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl m\nf 1/1 2/1 3/1\n"
    )
    mesh = read_mesh(tmp_path / "a.obj")
    assert mesh.texture is None or not mesh.texture.images
    assert [d.code for d in mesh.diagnostics] == ["mesh.texture-damaged"]


def test_a_small_jpeg_2000_file_of_a_huge_image_is_not_decoded(tmp_path: Path) -> None:
    """A file of 202 bytes used 12.7 GB."""
    data = make_huge_jpeg_2000(30_000, 30_000)
    started = time.process_time()
    path = tmp_path / "a.png"
    path.write_bytes(data)
    for read in (read_image_size, read_stored_image):
        with pytest.raises(InputError, match="JPEG 2000 images are not supported"):
            read(path)
    assert decode_image(data) is None
    assert time.process_time() - started < 1


def make_header(kind: str, width: int, height: int) -> bytes:
    """Make an image whose header states this size."""
    data = bytearray(encode_image(kind))
    match kind:
        case "JPEG":
            at = data.index(b"\xff\xc0") + 5
            struct.pack_into(">2H", data, at, height, width)
        case "BMP":
            struct.pack_into("<2i", data, 18, width, -height)
        case "GIF":
            struct.pack_into("<2H", data, data.index(b",", 13 + 3 * (2 << (data[10] & 7))) + 5, width, height)
        case "TGA":
            struct.pack_into("<2H", data, 12, width, height)
        case "WEBP":
            return b"RIFF\0\0\0\0WEBPVP8X\x0a\0\0\0\0\0\0\0" + b"".join(
                (n - 1).to_bytes(3, "little") for n in (width, height)
            )
        case "PPM":
            return f"P6\n# made\n{width} # wide\n{height}\n255\n".encode() + bytes(100)
    return bytes(data)


@pytest.mark.parametrize("kind", ["JPEG", "BMP", "GIF", "TGA", "WEBP", "PPM"])
def test_sizes_are_checked_before_decoding(kind: str) -> None:
    data = make_header(kind, 60_000, 50_000)
    assert read_header_size(data, "a.tga") == (60_000, 50_000)
    assert decode_image(data, "a.tga") is None
    if kind != "TGA":
        with pytest.raises(InputError, match="states 60000×50000 pixels"):
            decode_color(data, "a.png")


@pytest.mark.parametrize("kind", DECODED)
def test_damaged_images_are_decoded_or_refused(kind: str) -> None:
    whole = encode_image(kind, np.tile(PIXELS, (4, 3, 1)))
    draw = random.Random(7)
    for _ in range(150):
        data = bytearray(whole)
        for _ in range(draw.choice((1, 2, 5))):
            data[draw.randrange(min(len(data), draw.choice((30, 400))))] = draw.choice((0, 1, 127, 255))
        cut = bytes(data[: draw.randrange(1, len(data) + 1)])
        read_header_size(cut, "a.tga")
        pixels = decode_image(cut, "a.tga")
        assert pixels is None or pixels.ndim == 3
        with contextlib.suppress(InputError):
            assert decode_color(cut, "a.png").ndim == 3


@pytest.mark.parametrize(
    "data",
    [
        b"P6" + b" " * (1 << 20),
        b"P6\n" + b"#\n" * (1 << 19),
        b"\xff\xd8" + b"\xff" * (1 << 20),
        b"\xff\xd8" + b"\xff\xd0" * (1 << 19),
        b"GIF89a" + bytes(7) + b"!\xff\x01\x01\0" * (1 << 18),
        b"II*\0" + b"\x08\0\0\0" + b"\xff\xff" + bytes(1 << 20),
    ],
)
def test_long_headers_take_linear_time(data: bytes) -> None:
    started = time.process_time()
    read_header_size(data)
    assert time.process_time() - started < 2
