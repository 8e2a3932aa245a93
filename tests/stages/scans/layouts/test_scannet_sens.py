import struct
import zlib

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

UNITS = 500
# The known pixel (26, 17) is at 300 · (0.1, 0.05) + (50, 33) = (80, 48) in the colour images.
COLOR_MATRIX = np.array([[300, 0, 50, 0], [0, 300, 33, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
DEPTH_MATRIX = np.array([[100, 0, 16, 0], [0, 100, 12, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])
HEADER_BYTES = 4 + 8 + 4 + 4 * 64 + 4 + 4 + 16 + 4 + 8


def color_image():
    image = np.zeros((72, 96, 3), np.uint8)
    image[44:53, 76:85] = (0, 0, 255)
    return image


def header(promised=2, coders=(2, 1), units=UNITS, sizes=(96, 72, 32, 24), version=4, name=b"cam!"):
    matrices = (COLOR_MATRIX, np.eye(4), DEPTH_MATRIX, np.eye(4))
    return (
        struct.pack("<IQ", version, len(name))
        + name
        + b"".join(matrix.astype("<f4").tobytes() for matrix in matrices)
        + struct.pack("<ii4IfQ", *coders, *sizes, units, promised)
    )


def frame(pose, coders=(2, 1)):
    rgb = color_image()
    bgr = cv2.cvtColor(rgb, cv2.COLOR_RGB2BGR)
    color = (
        rgb.tobytes() if coders[0] == 0 else cv2.imencode({1: ".png", 2: ".jpg"}[coders[0]], bgr)[1].tobytes()
    )
    depth = np.full((24, 32), 2 * UNITS, "<u2")
    depth[0, 0] = 0
    packed = zlib.compress(depth.tobytes()) if coders[1] == 1 else depth.tobytes()
    return (
        np.asarray(pose, "<f4").tobytes()
        + struct.pack("<QQQQ", 0, 0, len(color), len(packed))
        + color
        + packed
    )


def content(tiny, coders=(2, 1)):
    # IMU samples may follow and are ignored.
    return header(coders=coders) + frame(tiny.identity, coders) + frame(tiny.second, coders) + bytes(8)


def written(folder, data):
    (folder / "scene.sens").write_bytes(data)
    return folder


@pytest.mark.parametrize("coders", [(2, 1), (1, 0), (0, 1)])
def test_known_points_and_colours_come_out(tmp_path, tiny, coders):
    scan = read_scan(written(tmp_path, content(tiny, coders)))
    assert scan.layout == "scannet-sens"
    assert not scan.diagnostics
    assert [one.name for one in scan.frames] == ["000000", "000001"]
    for one, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(one), point, atol=1e-6)
        depth = read_depth(one)
        assert depth[0, 0] == 0
        color = read_color_aligned_to_depth(one, depth)
        rows, columns = np.nonzero(color[:, :, 2] > 128)
        np.testing.assert_allclose((rows.mean(), columns.mean()), (17, 26), atol=0.01)
        assert color[17, 26, 0] < 30


def test_lost_and_wrong_poses_cost_their_frames(tmp_path, tiny):
    poses = (np.full((4, 4), -np.inf), np.diag((2, 1, 1, 1)), tiny.second)
    scan = read_scan(written(tmp_path, header(3) + b"".join(frame(pose) for pose in poses)))
    assert [one.name for one in scan.frames] == ["000002"]
    assert {one.name: one.reason.split(":")[-1] for one in scan.skipped_frames}.keys() == {"000000", "000001"}
    assert any("not rigid" in one.reason for one in scan.skipped_frames)
    np.testing.assert_allclose(tiny.seen(scan.frames[0]), tiny.points[1], atol=1e-6)


def test_stated_scale_camera_and_poses_win(tmp_path, tiny, matrix_text):
    written(tmp_path, content(tiny))
    (tmp_path / "mine.log").write_text(
        "0 0 1\n" + matrix_text(tiny.second) + "1 1 2\n" + matrix_text(tiny.identity)
    )
    options = ScanParams(poses="mine.log", depth_scale=1000, intrinsics="50,60,15,11")
    first, second = read_scan(tmp_path, options).frames
    assert (first.camera.fx, first.camera.fy, first.camera.cx, first.camera.cy) == (50, 60, 15, 11)
    assert read_depth(first)[5, 5] == 1
    np.testing.assert_array_equal(first.world_from_camera, tiny.second)
    np.testing.assert_array_equal(second.world_from_camera, tiny.identity)


def test_a_scan_without_colour(tmp_path, tiny):
    depth = zlib.compress(np.full((24, 32), 2 * UNITS, "<u2").tobytes())
    frames = b"".join(
        np.asarray(pose, "<f4").tobytes() + struct.pack("<QQQQ", 0, 0, 0, len(depth)) + depth
        for pose in (tiny.identity, tiny.second)
    )
    scan = read_scan(written(tmp_path, header(sizes=(0, 0, 32, 24)) + frames))
    assert scan.frames[0].color is None
    np.testing.assert_allclose(tiny.seen(scan.frames[1]), tiny.points[1], atol=1e-6)


@pytest.mark.parametrize("end", range(HEADER_BYTES))
def test_a_header_cut_short_is_refused(tmp_path, tiny, end):
    with pytest.raises(InputError, match=r"scene\.sens"):
        read_scan(written(tmp_path, content(tiny)[:end]))


def test_frames_before_a_cut_are_kept(tmp_path, tiny):
    data = content(tiny)[:-8]
    one = len(frame(tiny.identity))
    for end in range(HEADER_BYTES, len(data) + 1, 13):
        written(tmp_path, data[:end])
        whole = (end - HEADER_BYTES) // one
        if whole == 0:
            with pytest.raises(InputError, match="is complete"):
                read_scan(tmp_path)
            continue
        scan = read_scan(tmp_path)
        assert len(scan.frames) == whole
        assert any("truncated" in text for text in map(str, scan.diagnostics)) == (whole < 2)
        for kept in scan.frames:
            assert read_color(kept).shape == (72, 96, 3)
            assert read_depth(kept).shape == (24, 32)


@pytest.mark.slow
@pytest.mark.parametrize("value", [0x00, 0x7F, 0xFF])
def test_any_damaged_byte_is_refused_or_costs_frames(tmp_path, tiny, value):
    data = content(tiny)
    one = len(frame(tiny.identity))
    places = [*range(HEADER_BYTES + 96), *range(HEADER_BYTES + one, HEADER_BYTES + one + 96)]
    places += range(HEADER_BYTES + 96, HEADER_BYTES + one, 37)
    for at in places:
        written(tmp_path, data[:at] + bytes([value]) + data[at + 1 :])
        try:
            for kept in read_scan(tmp_path).frames:
                read_color(kept)
                read_depth(kept)
        except InputError as error:
            assert "scene.sens" in str(error) or str(tmp_path) in str(error)  # noqa: PT017


def test_billions_of_promised_frames(tmp_path, tiny):
    scan = read_scan(written(tmp_path, header(1 << 62) + frame(tiny.identity) + frame(tiny.second)))
    assert len(scan.frames) == 2
    assert any(str(1 << 62) in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"version": 3}, "version 4"),
        ({"coders": (7, 1)}, "compression 7"),
        ({"coders": (2, 2)}, "compression 2"),
        ({"sizes": (96, 72, 1 << 31, 1 << 31)}, "damaged"),
        ({"sizes": (96, 72, 0, 24)}, "damaged"),
        ({"units": 0}, "depth units"),
        ({"units": float("nan")}, "depth units"),
    ],
)
def test_headers_that_cannot_be_right(tmp_path, tiny, changed, words):
    with pytest.raises(InputError, match=words):
        read_scan(written(tmp_path, header(**changed) + frame(tiny.identity)))


def test_a_depth_map_that_swells_is_stopped(tmp_path):
    bomb = zlib.compress(bytes(1 << 24))
    entry = np.eye(4, dtype="<f4").tobytes() + struct.pack("<QQQQ", 0, 0, 0, len(bomb)) + bomb
    scan = read_scan(written(tmp_path, header(1) + entry))
    with pytest.raises(InputError, match=r"scene\.sens: depth 000000: .*32×24"):
        read_depth(scan.frames[0])


def test_two_recordings_are_not_one_scan(tmp_path, tiny):
    written(tmp_path, content(tiny))
    (tmp_path / "other.sens").write_bytes(content(tiny))
    with pytest.raises(InputError, match=r"2 \.sens files"):
        read_scan(tmp_path)


def test_one_of_several_recordings_is_given(tmp_path, tiny):
    (tmp_path / "a.sens").write_bytes(header(1) + frame(tiny.second))
    (tmp_path / "b.sens").write_bytes(content(tiny))
    with pytest.raises(InputError, match=r"2 \.sens files \(a\.sens, b\.sens\).*give the file to read"):
        read_scan(tmp_path)
    (only,) = read_scan(tmp_path / "a.sens").frames
    np.testing.assert_allclose(tiny.seen(only), tiny.points[1], atol=1e-6)
    (tmp_path / "scene0000_00.txt").write_text(f"axisAlignment = {ALIGNMENT}")
    (only,) = read_scan(tmp_path / "a.sens", ScanParams(align_axes=True)).frames
    x, y, z = tiny.points[1]
    np.testing.assert_allclose(tiny.seen(only), (10 - y, 20 + x, 30 + z), atol=1e-6)


# A quarter turn about z, from x to y, and a shift.
ALIGNMENT = "0 -1 0 10 1 0 0 20 0 0 1 30 0 0 0 1"


def test_the_axes_are_aligned_on_request_only(tmp_path, tiny):
    written(tmp_path, content(tiny))
    (tmp_path / "scene0000_00.txt").write_text(
        f"appVersionId = 9\naxisAlignment = {ALIGNMENT}\nsceneType = Den\n"
    )
    np.testing.assert_allclose([tiny.seen(one) for one in read_scan(tmp_path).frames], tiny.points, atol=1e-6)
    scan = read_scan(tmp_path, ScanParams(align_axes=True))
    turned = [(10 - y, 20 + x, 30 + z) for x, y, z in tiny.points]
    np.testing.assert_allclose([tiny.seen(one) for one in scan.frames], turned, atol=1e-6)
    assert "the world is rotated by the axisAlignment of scene0000_00.txt" in map(str, scan.diagnostics)
    assert scan.up.direction == (0.0, 0.0, 1.0)
    tilted = "0 0 1 0 1 0 0 0 0 1 0 0 0 0 0 1"
    (tmp_path / "scene0000_00.txt").write_text(f"axisAlignment = {tilted}\n")
    assert read_scan(tmp_path, ScanParams(align_axes=True)).up.direction == (1.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("sceneType = Den", r"no scene\*\.txt with an axisAlignment"),
        ("axisAlignment = 1 2 3", r"scene0000_00\.txt.*must be 16 numbers"),
        ("axisAlignment = " + ALIGNMENT.replace("-1", "x"), r"scene0000_00\.txt.*must be 16 numbers"),
        ("axisAlignment = " + ALIGNMENT.replace("-1", "1"), r"scene0000_00\.txt.*mirrors"),
        ("axisAlignment = " + " ".join(["nan"] * 16), r"scene0000_00\.txt.*NaN or infinity"),
    ],
)
def test_a_wrong_alignment_is_reported(tmp_path, tiny, text, message):
    written(tmp_path, content(tiny))
    (tmp_path / "scene0000_00.txt").write_text(text)
    assert read_scan(tmp_path).frames
    with pytest.raises(InputError, match=message):
        read_scan(tmp_path, ScanParams(align_axes=True))
