import json

import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

UNITS = 6553.5


@pytest.fixture
def scan_folder(tmp_path, tiny):
    folder = tmp_path / "room0"
    for number in (0, 2):
        tiny.color(folder / "results" / f"frame{number:06d}.jpg")
        tiny.depth(folder / "results" / f"depth{number:06d}.png", UNITS)
    # A pose for every image of the full sequence; frame 1 is not in the excerpt.
    rows = [tiny.identity.ravel(), np.eye(4).ravel(), tiny.second.ravel()]
    (folder / "traj.txt").write_text("\n".join(" ".join(f"{v:.9e}" for v in row) for row in rows) + "\n")
    camera = {"w": 32, "h": 24, "fx": 100, "fy": 100, "cx": 16, "cy": 12, "scale": UNITS}
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder


def assert_known_points(folder, tiny, **options):
    scan = read_scan(folder, ScanParams(**options))
    assert scan.layout == "replica"
    assert [frame.name for frame in scan.frames] == ["000000", "000002"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-4)
    return scan


def test_known_points_come_out_in_the_world(scan_folder, tiny):
    # Two of three poses are used, which is the only report.
    found = assert_known_points(scan_folder, tiny).diagnostics
    said = "it holds 3 poses for 2 frames; they are assigned by the number in each frame's name"
    assert [str(one) for one in found] == [f"{scan_folder / 'traj.txt'}: {said}"]


def test_the_camera_file_of_all_rooms_is_found(scan_folder, tiny):
    path = scan_folder / "cam_params.json"
    path.rename(scan_folder.parent / path.name)
    assert_known_points(scan_folder, tiny)


def test_the_scale_of_the_camera_file_is_used(scan_folder, tiny):
    path = scan_folder / "cam_params.json"
    path.write_text(path.read_text().replace("6553.5", "1000"))
    for number in (0, 2):
        tiny.depth(scan_folder / "results" / f"depth{number:06d}.png", 1000)
    assert_known_points(scan_folder, tiny)


def test_without_a_camera_file_the_known_camera_is_used_and_reported(scan_folder, tiny):
    (scan_folder / "cam_params.json").unlink()
    assert_known_points(scan_folder, tiny, intrinsics=tiny.option)
    scan = read_scan(scan_folder)
    camera = scan.frames[0].camera
    # 1200×680 reduced to 32×24: 37.5 times smaller in width, 28.33 times in height.
    expected = (16, 600 * 24 / 680, 15.5, 11.5)
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), expected)
    assert any("cam_params.json" in text for text in map(str, scan.diagnostics))


def test_a_camera_of_another_size_is_refused(scan_folder):
    path = scan_folder / "cam_params.json"
    path.write_text(path.read_text().replace('"w": 32', '"w": 1200'))
    with pytest.raises(InputError, match=r"cam_params\.json.*1200×24.*32×24"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    "text",
    ["", "[]", '{"camera": 3}', '{"camera": {"w": 32, "h": 24, "fx": 1}}', '{"camera": {"scale": 0}}', "{"],
)
def test_a_wrong_camera_file_is_refused(scan_folder, text):
    (scan_folder / "cam_params.json").write_text(text)
    with pytest.raises(InputError, match=r"cam_params\.json"):
        read_scan(scan_folder)


@pytest.mark.parametrize(
    "text", ["", "1 2 3 4 5\n", "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1\n", "2 0 0 0 0 1 0 0 0 0 1 0\n"]
)
def test_a_wrong_trajectory_is_refused(scan_folder, text):
    (scan_folder / "traj.txt").write_text(text)
    with pytest.raises(InputError, match=r"traj\.txt"):
        read_scan(scan_folder)


def test_a_missing_image_costs_its_frame_only(scan_folder):
    (scan_folder / "results" / "frame000000.jpg").unlink()
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["000002"]
    assert "results/frame*" in scan.skipped_frames[0].reason


def test_empty_results(scan_folder):
    for path in (scan_folder / "results").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="no images in results/depth"):
        read_scan(scan_folder)
