import contextlib
import struct

import numpy as np
import OpenEXR
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.exr import read_exr, read_exr_size
from scanloom.stages.files.images import read_image_size
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, Frame

DEPTH = np.random.default_rng(0).uniform(0.5, 4, (24, 32)).astype(np.float32)
METHODS = ("NO", "RLE", "ZIPS", "ZIP", "PIZ")


def write_exr(path, channels, method="ZIP"):
    header = {"compression": getattr(OpenEXR, f"{method}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))
    return path


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", ["Z", "R", "Y", "anything"])
def test_a_single_channel_is_depth_for_any_name(tmp_path, method, name):
    path = write_exr(tmp_path / "a.exr", {name: DEPTH}, method)
    np.testing.assert_array_equal(read_exr(path), DEPTH)
    assert read_exr_size(path) == read_image_size(path) == (32, 24)


def test_exr_is_read_as_a_depth_map(tmp_path):
    depth = DEPTH.copy()
    depth[0, :3] = (np.nan, np.inf, -1)
    path = write_exr(tmp_path / "a.EXR", {"Z": depth})
    read = read_depth(Frame("f", Camera(32, 24, 100, 100, 16, 12), depth=path, depth_scale=1.0))
    assert read[0, :3].tolist() == [0, 0, 0]
    np.testing.assert_array_equal(read[1:], DEPTH[1:])


def test_half_floats_and_integers_are_read(tmp_path):
    half = DEPTH.astype(np.float16)
    np.testing.assert_array_equal(read_exr(write_exr(tmp_path / "h.exr", {"Z": half})), half)
    whole = (DEPTH * 1000).astype(np.uint32)
    np.testing.assert_array_equal(read_exr(write_exr(tmp_path / "w.exr", {"Z": whole})), whole)


def test_depth_is_channel_z_or_grey(tmp_path):
    other = np.zeros_like(DEPTH)
    path = write_exr(tmp_path / "a.exr", {"R": other, "G": other, "B": other, "Z": DEPTH})
    np.testing.assert_array_equal(read_exr(path), DEPTH)
    path = write_exr(tmp_path / "b.exr", {"R": DEPTH, "G": DEPTH, "B": DEPTH})
    np.testing.assert_array_equal(read_exr(path), DEPTH)


def test_a_colour_image_is_not_depth(tmp_path):
    path = write_exr(tmp_path / "a.exr", {"R": DEPTH, "G": DEPTH + 1, "B": DEPTH})
    with pytest.raises(
        InputError, match=r"the depth channel is ambiguous: the image has the channels B, G, R"
    ):
        read_exr(path)


@pytest.mark.parametrize("method", METHODS)
def test_truncated_files_are_reported(tmp_path, method, capfd):
    path = write_exr(tmp_path / "a.exr", {"Z": DEPTH}, method)
    data = path.read_bytes()
    for length in [*range(0, len(data), 37), len(data) - 1]:
        path.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"a\.exr: "):
            read_exr(path)
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("method", METHODS)
def test_damage_gives_an_error_or_other_values(tmp_path, method, capfd):
    path = write_exr(tmp_path / "a.exr", {"Z": DEPTH}, method)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    for _ in range(200):
        broken = bytearray(data)
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            broken[at] = rng.integers(256)
        path.write_bytes(broken)
        with contextlib.suppress(InputError):
            assert read_exr(path).ndim == 2
    # Standard output is reserved for results, so messages of the library must not appear.
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("box", [(0, 0, 99_999, 99_999), (-(2**31), 0, 2**31 - 1, 0), (5, 5, 0, 0)])
def test_a_header_with_a_huge_size_is_refused_before_decoding(tmp_path, box):
    path = write_exr(tmp_path / "a.exr", {"Z": DEPTH})
    data = path.read_bytes()
    path.write_bytes(data.replace(struct.pack("<4i", 0, 0, 31, 23), struct.pack("<4i", *box)))
    for read in (read_exr, read_exr_size):
        with pytest.raises(InputError, match="header is damaged"):
            read(path)


def test_tiled_images_are_refused(tmp_path):
    path = write_exr(tmp_path / "a.exr", {"Z": DEPTH})
    data = bytearray(path.read_bytes())
    data[5] |= 2
    path.write_bytes(data)
    with pytest.raises(InputError, match="tiles"):
        read_exr(path)


def test_a_missing_file_is_reported(tmp_path):
    for read in (read_exr, read_exr_size):
        with pytest.raises(InputError, match=r"gone\.exr: the image cannot be opened"):
            read(tmp_path / "gone.exr")
