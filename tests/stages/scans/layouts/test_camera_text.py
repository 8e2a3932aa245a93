import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def rotated(metres: float, scale: float = 10_000.0) -> np.ndarray:
    """Make depth of a slanted wall, `metres` away at the known pixel, with bits rotated left by three."""
    slant = np.arange(-26, 6)[None, :] * 200 + np.arange(-17, 7)[:, None] * 41
    depth = round(metres * scale) + slant
    depth = np.repeat(np.repeat(depth, 4, 0), 4, 1).astype(np.uint16)
    return (depth << 3) | (depth >> 13)


def block(heading, matrix, matrix_text):
    return f"# {heading}\n{matrix_text(np.asarray(matrix, float))}\n"


@pytest.fixture
def scan_folder(tmp_path, tiny, matrix_text):
    # The images are four times as large, enough to detect the rotated bits.
    camera = [[400, 0, 65.5], [0, 400, 49.5], [0, 0, 1]]
    text = "# Environment: shelf\n# Bin ID: B\n\n"
    text += block("Color camera intrinsic matrix", camera, matrix_text)
    text += block("Depth camera intrinsic matrix", np.diag((300.0, 300.0, 1.0)), matrix_text)
    text += block("Depth-to-color camera extrinsic matrix", np.eye(4), matrix_text)
    text += block("Bin-to-world transformation matrix", np.eye(4), matrix_text)
    for number, pose in enumerate((tiny.identity, tiny.second)):
        stem = f"frame-{number:06}"
        tiny.color(tmp_path / f"{stem}.color.png", (128, 96))
        assert cv2.imwrite(str(tmp_path / f"{stem}.depth.png"), rotated(2.0))
        text += block(f"Camera-to-world extrinsic matrix (camera pose) for {stem}", pose, matrix_text)
    (tmp_path / "cam.info.txt").write_text(text)
    return tmp_path


def seen(frame):
    from scanloom.stages.scans.model.images import read_depth

    z = float(read_depth(frame)[17 * 4, 26 * 4])
    u, v = 26 * 4 + 1.5, 17 * 4 + 1.5
    camera = frame.camera
    point = ((u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z, 1.0)
    return (frame.world_from_camera @ point)[:3]


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert (scan.layout, [frame.name for frame in scan.frames]) == (
        "camera-text",
        ["frame-000000", "frame-000001"],
    )
    np.testing.assert_allclose([seen(frame) for frame in scan.frames], tiny.points, atol=1e-6)
    # Unused statements of the file are reported.
    assert any("Bin-to-world transformation matrix" in text for text in map(str, scan.diagnostics))


def test_depth_of_another_size_has_a_separate_camera(scan_folder, tiny, matrix_text):
    # The colour camera is 0.1 m left of the depth camera; the poses are of the colour camera.
    beside = np.eye(4)
    beside[0, 3] = 0.1
    text = (scan_folder / "cam.info.txt").read_text()
    own = block("Depth camera intrinsic matrix", [[100, 0, 16], [0, 100, 12], [0, 0, 1]], matrix_text)
    moved = block("Depth-to-color camera extrinsic matrix", beside, matrix_text)
    for heading, new in (("Depth camera", own), ("Depth-to-color", moved)):
        start = text.index(f"# {heading}")
        text = text[:start] + new + text[text.index("\n#", start) + 1 :]
    (scan_folder / "cam.info.txt").write_text(text)
    for number in range(2):
        tiny.depth(scan_folder / f"frame-{number:06}.depth.png", 1000)
    scan = read_scan(scan_folder)
    shift = np.array([[0.1, 0, 0], tiny.second[:3, 0] * 0.1])
    np.testing.assert_allclose([tiny.seen(frame) for frame in scan.frames], tiny.points + shift, atol=1e-6)
    assert scan.frames[0].color_camera.fx == 400
    assert any("are not rotated" in text for text in map(str, scan.diagnostics))


@pytest.mark.parametrize("name", ["cam.info.txt", "cameras of the day.txt"])
def test_the_text_is_known_by_its_headings(scan_folder, name):
    (scan_folder / "cam.info.txt").rename(scan_folder / name)
    assert read_scan(scan_folder).layout == "camera-text"


def test_poses_of_the_other_direction_and_of_a_trajectory(scan_folder, tiny, matrix_text):
    text = (scan_folder / "cam.info.txt").read_text()
    head = text[: text.index("# Camera-to-world")]
    inverse = "".join(
        block(f"World-to-camera matrix for frame-{number:06}", np.linalg.inv(pose), matrix_text)
        for number, pose in enumerate((tiny.identity, tiny.second))
    )
    (scan_folder / "cam.info.txt").write_text(head + inverse)
    np.testing.assert_allclose([seen(one) for one in read_scan(scan_folder).frames], tiny.points, atol=1e-6)
    given = scan_folder / "given.txt"
    given.write_text("0 0 0 0 0 0 1\n1 2 3 " + " ".join(map(str, tiny.second_quaternion)) + "\n")
    (scan_folder / "cam.info.txt").write_text(text)
    scan = read_scan(scan_folder, ScanParams(poses=str(given)))
    np.testing.assert_allclose([seen(one) for one in scan.frames], tiny.points, atol=1e-6)


def test_a_frame_without_depth_is_left_out(scan_folder):
    (scan_folder / "frame-000001.depth.png").unlink()
    scan = read_scan(scan_folder)
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        ("frame-000001", "its depth map is missing")
    ]
    (scan_folder / "frame-000000.depth.png").unlink()
    with pytest.raises(InputError, match="none of the 2 listed frames has a depth map, such as frame-000000"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("400 0 65.5", "400 0", "the rows below line 4 have different lengths"),
        ("400 0 65.5", "400 x 65.5", "line 5 holds something that is not a number"),
        ("1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1", "1 0\n0 1", "is not 3x3, 3x4 or 4x4"),
        ("for frame-000001", "for frame-000000", "frame-000000 has two poses"),
        ("# Environment: shelf", "7", "line 1 has no heading"),
        ("400 0 65.5", "nan 0 65.5", "not finite"),
    ],
)
def test_damaged_files_are_reported(scan_folder, old, new, message):
    path = scan_folder / "cam.info.txt"
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(InputError, match=message):
        read_scan(scan_folder)


def test_headings_with_tabs_and_a_text_that_is_empty(scan_folder, tiny):
    path = scan_folder / "cam.info.txt"
    path.write_text(path.read_text().replace(" ", "\t"))
    np.testing.assert_allclose([seen(one) for one in read_scan(scan_folder).frames], tiny.points, atol=1e-6)
    path.write_text("# Environment: shelf\n")
    with pytest.raises(InputError, match="the file has no heading for the pose of a frame"):
        read_scan(scan_folder)
