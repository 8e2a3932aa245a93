import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import read_image_size
from scanloom.stages.scans.model.images import read_color, read_depth, read_right, read_valid_pixels
from scanloom.stages.scans.model.scan import Camera, Frame

CAMERA = Camera(32, 24, 100, 100, 16, 12)


def frame(**images):
    return Frame("f", CAMERA, **images)


def png_of_size(path, width, height):
    header = b"IHDR" + width.to_bytes(4, "big") + height.to_bytes(4, "big") + b"\x08\x02\x00\x00\x00"
    chunk = (13).to_bytes(4, "big") + header + zlib.crc32(header).to_bytes(4, "big")
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + chunk + b"\x00\x00\x00\x00IEND\xaeB`\x82")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".ppm", ".bmp", ".tif"])
def test_the_size_is_width_then_height(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint8))
    assert read_image_size(path) == (32, 24)


def test_grey_and_transparent_images_become_rgb(tmp_path):
    cv2.imwrite(str(tmp_path / "grey.png"), np.full((24, 32), 7, np.uint8))
    cv2.imwrite(str(tmp_path / "bgra.png"), np.full((24, 32, 4), (1, 2, 3, 255), np.uint8))
    assert read_color(frame(color=tmp_path / "grey.png"))[0, 0].tolist() == [7, 7, 7]
    assert read_right(frame(right=tmp_path / "bgra.png"))[0, 0].tolist() == [3, 2, 1]


def test_missing_images_are_none():
    assert read_color(frame()) is None
    assert read_right(frame()) is None
    assert read_depth(frame()) is None


def test_depth_in_memory_is_cleaned():
    depth = np.full((24, 32), 1.5, np.float32)
    depth[0, :4] = (np.nan, np.inf, -1, 9e-44)
    read = read_depth(frame(depth=depth))
    assert read[0, :5].tolist() == [0, 0, 0, 0, 1.5]


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_an_image_cut_short_is_reported(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 255, (240, 320, 3), np.uint8))
    path.write_bytes(path.read_bytes()[:20_000])
    with pytest.raises(InputError, match=r"a\.(png|jpg): the image is cut short"):
        read_color(frame(color=path))


def test_a_part_of_a_png_that_claims_gigabytes_is_refused_before_decoding(tmp_path):
    path = tmp_path / "a.png"
    cv2.imwrite(str(path), np.zeros((24, 32, 3), np.uint8))
    data = path.read_bytes()
    at = data.index(b"IDAT")
    path.write_bytes(data[: at - 4] + b"\xff\xff\x7f\xbf" + data[at:])
    with pytest.raises(InputError, match=r"a\.png: the image is cut short"):
        read_color(frame(color=path))


@pytest.mark.parametrize("size", [(60_000, 60_000), (0, 10), (2**31, 2**31)])
def test_a_header_that_promises_a_giant_is_refused_before_decoding(tmp_path, size):
    png_of_size(tmp_path / "a.png", *size)
    with pytest.raises(InputError, match="header is damaged"):
        read_color(frame(color=tmp_path / "a.png"))


def test_a_giant_map_is_refused(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"P5 100000 100000 65535\n" + bytes(100))
    with pytest.raises(InputError, match="header is damaged"):
        read_depth(frame(depth=tmp_path / "a.pgm"))


@pytest.mark.parametrize("content", [b"", b"hello", b"\xff\xd8\xff", b"\x89PNG\r\n\x1a\n"])
def test_a_file_that_is_not_an_image_is_reported(tmp_path, content):
    path = tmp_path / "a.jpg"
    path.write_bytes(content)
    with pytest.raises(InputError, match=r"a\.jpg: the image"):
        read_color(frame(color=path))
    with pytest.raises(InputError, match=r"a\.jpg: the image"):
        read_image_size(path)


def test_a_missing_image_is_reported(tmp_path):
    with pytest.raises(InputError, match=r"gone\.png: the image cannot be opened"):
        read_color(frame(color=tmp_path / "gone.png"))


def test_bits_and_channels_are_not_mixed_up(tmp_path):
    cv2.imwrite(str(tmp_path / "deep.png"), np.zeros((24, 32, 3), np.uint16))
    cv2.imwrite(str(tmp_path / "shallow.png"), np.zeros((24, 32), np.uint8))
    with pytest.raises(InputError, match=r"deep\.png: .*8 bits per channel.*uint16"):
        read_color(frame(color=tmp_path / "deep.png"))
    with pytest.raises(InputError, match=r"deep\.png: .*colour image"):
        read_depth(frame(depth=tmp_path / "deep.png"))
    with pytest.raises(InputError, match=r"shallow\.png: .*8 bits"):
        read_depth(frame(depth=tmp_path / "shallow.png"))


def test_depth_of_another_size_is_reported(tmp_path):
    cv2.imwrite(str(tmp_path / "a.png"), np.zeros((48, 64), np.uint16))
    with pytest.raises(InputError, match=r"a\.png: the image is 64×48 px, .* 32×24 px"):
        read_depth(frame(depth=tmp_path / "a.png"))


def test_damaged_arrays_are_reported(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.ones((24, 32), np.float32))
    data = path.read_bytes()
    path.write_bytes(data.replace(b"(24, 32)", b"(99999999, 99999999)"))
    with pytest.raises(InputError, match=r"a\.npy"):
        read_depth(frame(depth=path))
    path.write_bytes(data.replace(b"'<f4'", b"('<f4"))
    with pytest.raises(InputError, match=r"a\.npy"):
        read_depth(frame(depth=path))
    path.write_bytes(data[:200])
    with pytest.raises(InputError, match=r"a\.npy"):
        read_depth(frame(depth=path))
    np.save(path, np.array([{"no": "numbers"}]), allow_pickle=True)
    with pytest.raises(InputError, match=r"a\.npy"):
        read_depth(frame(depth=path))
    np.save(path, np.full((24, 32), "x"))
    with pytest.raises(InputError, match=r"a\.npy"):
        read_depth(frame(depth=path))


def test_distortion_of_rgbd_frames_is_removed(tmp_path):
    """A dot at the distorted position is read at the pinhole position."""
    camera = Camera(320, 240, 200, 200, 160, 120, (-0.3, 0.1, 0.001, 0.002))
    ray = np.array([[[0.6, -0.4, 1.0]]])
    projected, _ = cv2.projectPoints(
        ray, np.zeros(3), np.zeros(3), camera.matrix, np.array(camera.distortion)
    )
    u, v = projected[0, 0]
    depth = np.zeros((240, 320), np.uint16)
    color = np.zeros((480, 640, 3), np.uint8)
    cv2.circle(depth, (round(u), round(v)), 2, 3000, -1)
    cv2.circle(color, (round(2 * u), round(2 * v)), 4, (255, 255, 255), -1)
    cv2.imwrite(str(tmp_path / "depth.png"), depth)
    cv2.imwrite(str(tmp_path / "color.png"), color)
    read = Frame("f", camera, tmp_path / "color.png", depth=tmp_path / "depth.png")
    pinhole = np.array((200 * 0.6 + 160, 200 * -0.4 + 120))
    assert np.hypot(u - pinhole[0], v - pinhole[1]) > 10
    rows, columns = np.nonzero(read_depth(read))
    np.testing.assert_allclose((columns.mean(), rows.mean()), pinhole, atol=1)
    assert read_depth(read)[rows[0], columns[0]] == 3
    rows, columns = np.nonzero(read_color(read)[:, :, 0] > 128)
    np.testing.assert_allclose((columns.mean(), rows.mean()), 2 * pinhole + 0.5, atol=1.5)
    pair = Frame("f", camera, tmp_path / "color.png", right=tmp_path / "color.png")
    np.testing.assert_array_equal(read_color(pair), color)


def test_masked_pixels_have_no_depth_and_are_invalid():
    camera = Camera(8, 6, 10, 10, 3.5, 2.5)
    mask = np.zeros((12, 16, 3), np.uint8)
    mask[:, 8:, 1] = 1
    frame = Frame("a", camera, depth=np.full((6, 8), 2, np.float32), mask=mask)
    np.testing.assert_array_equal(read_depth(frame)[3], [0, 0, 0, 0, 2, 2, 2, 2])
    np.testing.assert_array_equal(read_valid_pixels(frame)[3], [0, 0, 0, 0, 1, 1, 1, 1])
    with pytest.raises(InputError, match=r"frame a: a mask with 8 bits"):
        read_valid_pixels(replace(frame, mask=mask.astype(np.uint16)))


def test_pixels_beyond_a_distorted_image_are_invalid():
    """Pincushion distortion: the corners of the pinhole image are outside the recorded image."""
    bent = Camera(64, 48, 60, 60, 31.5, 23.5, (0.5, 0, 0, 0))
    seen = read_valid_pixels(Frame("a", bent))
    # (x, y) = (31.5, 23.5) / 60 is projected 1 + 0.5 r² times as far, 12 % farther out: 3.8 px beyond the
    # border.
    assert not seen[[0, 0, -1, -1], [0, -1, 0, -1]].any()
    assert seen[8:40, 8:56].all()
    assert read_valid_pixels(Frame("a", replace(bent, distortion=()))).all()


def test_an_impossible_file_name_is_reported(tmp_path):
    with pytest.raises(InputError, match="cannot be opened"):
        read_color(frame(color=tmp_path / "a\0b.png"))
