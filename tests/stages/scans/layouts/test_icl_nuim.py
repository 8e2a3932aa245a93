from dataclasses import replace

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

HALF = 0.5**0.5
# In OpenCV axes, with y down in the world, too: rotated by 90° about +x, at (1, 2, 3). The known camera point
# (0.2, 0.1, 2) is rotated to (0.2, -2, 0.1) and is at (1.2, 0, 3.1).
TURNED_POINT = (1.2, 0.0, 3.1)


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for number in (0, 1, 2):
        tiny.color(tmp_path / "rgb" / f"{number}.png")
        tiny.depth(tmp_path / "depth" / f"{number}.png", 5000)
    (tmp_path / "associations.txt").write_text(
        "".join(f"{n} depth/{n}.png {n} rgb/{n}.png\n" for n in (0, 1, 2))
    )
    # Convention of the data set, y up in camera and world: the rotation is -90°, the height is -2. The first
    # image has no pose.
    (tmp_path / "livingRoom1.gt.freiburg").write_text(f"1 0 0 0 0 0 0 1\n2 1 -2 3 {-HALF} 0 0 {HALF}\n")
    return tmp_path


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert scan.layout == "icl-nuim"
    assert [frame.name for frame in scan.frames] == ["1", "2"]
    assert [(one.name, one.reason) for one in scan.skipped_frames] == [
        ("0", "the trajectory has no pose with its number")
    ]
    for frame, point in zip(scan.frames, (tiny.points[0], TURNED_POINT), strict=True):
        assert frame.color.stem == frame.depth.stem
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


def test_points_agree_with_the_published_camera(scan_folder, tiny):
    # With fy = -480 and the pose of the file, whose world has y up instead of down.
    frame = read_scan(scan_folder).frames[1]
    u, v = 26, 17
    fx, fy, cx, cy = (481.2 / 20, -480 / 20, 320 / 20 - 0.5, 240 / 20 - 0.5)
    x, y, z = (u - cx) / fx * 2, (v - cy) / fy * 2, 2
    world = np.array([x + 1, z - 2, -y + 3])
    np.testing.assert_allclose(tiny.seen(frame), world * (1, -1, 1), atol=1e-6)
    assert np.linalg.det(frame.world_from_camera) == pytest.approx(1)


def test_colour_may_be_listed_first(scan_folder):
    lines = "".join(f"{n} rgb/{n}.png {n} depth/{n}.png\n" for n in (0, 1, 2))
    (scan_folder / "associations.txt").write_text(lines)
    frame = read_scan(scan_folder).frames[0]
    assert (frame.color.parent.name, frame.depth.parent.name) == ("rgb", "depth")


def test_a_user_trajectory_has_y_down(scan_folder, tiny):
    (scan_folder / "mine.txt").write_text(f"1 0 0 0 0 0 0 1\n2 1 2 3 {HALF} 0 0 {HALF}\n")
    options = ScanParams(intrinsics=tiny.option, poses="mine.txt")
    np.testing.assert_allclose(tiny.seen(read_scan(scan_folder, options).frames[1]), TURNED_POINT, atol=1e-6)


def test_several_trajectories_are_not_guessed_at(scan_folder):
    (scan_folder / "livingRoom2.gt.freiburg").write_text("1 0 0 0 0 0 0 1\n")
    with pytest.raises(InputError, match=r"livingRoom1\.gt\.freiburg, livingRoom2.*scan\.poses"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "1 depth/1.png\n",
        "x depth/1.png 1 rgb/1.png\n",
        "1 depth/1.png 1 depth/1.png\n",
        "1 depth/1.png 1 ../rgb/1.png\n",
        "\xff\xfe",
    ],
)
def test_wrong_associations_are_refused(scan_folder, text):
    (scan_folder / "associations.txt").write_text(text, encoding="latin-1")
    with pytest.raises(InputError, match=r"associations\.txt"):
        read_scan(scan_folder)


@pytest.mark.parametrize("text", ["", "1 2 3\n", "1 0 0 0 9 9 9 9\n", "1 0 0 nan 0 0 0 1\n", "\x00\x01"])
def test_wrong_poses_are_refused(scan_folder, text):
    (scan_folder / "livingRoom1.gt.freiburg").write_text(text)
    with pytest.raises(InputError, match=r"livingRoom1\.gt\.freiburg"):
        read_scan(scan_folder)


def test_poses_of_another_clock_are_assigned_in_order(scan_folder, tiny):
    turned = " ".join(map(str, tiny.second_quaternion))
    (scan_folder / "mine.tum").write_text(f"500 0 0 0 0 0 0 1\n501 1 2 3 {turned}\n502 0 0 0 0 0 0 1\n")
    named = ScanParams(poses="mine.tum", intrinsics=tiny.option)
    with pytest.raises(InputError, match=r"none of its 3 poses .* as many poses as frames: scan\.poses"):
        read_scan(scan_folder, named)
    scan = read_scan(scan_folder, replace(named, poses_by_order=True))
    assert [frame.name for frame in scan.frames] == ["0", "1", "2"]
    np.testing.assert_allclose([tiny.seen(one) for one in scan.frames[:2]], tiny.points, atol=1e-6)
