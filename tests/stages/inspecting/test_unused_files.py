import json

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.inspecting.inspect import inspect
from scanloom.stages.inspecting.unused_files import find_unused_files
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_CONTRADICTORY
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CAMERA = {"width": 32, "height": 24, "fx": 30, "fy": 30, "cx": 15.5, "cy": 11.5}


@pytest.fixture
def scan_folder(tmp_path):
    for number in range(2):
        for place, image in (
            ("color", np.zeros((24, 32, 3), np.uint8)),
            ("depth", np.full((24, 32), 900, np.uint16)),
        ):
            (tmp_path / place).mkdir(exist_ok=True)
            assert cv2.imwrite(str(tmp_path / place / f"{number}.png"), image)
    (tmp_path / "intrinsic.json").write_text(json.dumps(CAMERA))
    return tmp_path


def list_warnings(folder, **options):
    return [str(one) for one in find_unused_files(read_scan(folder, ScanParams(**options), complete=False))]


def test_a_folder_without_unused_files_raises_no_warning(scan_folder):
    (scan_folder / "README.md").write_text("for people")
    (scan_folder / ".hidden").write_text("for nobody")
    assert list_warnings(scan_folder) == []
    # Files of frames that are not selected are not unused files.
    assert list_warnings(scan_folder, last=0) == []


def test_unused_files_are_described_by_their_content(scan_folder):
    (scan_folder / "other.json").write_text(json.dumps(CAMERA))
    (scan_folder / "camera_path.txt").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n" * 3)
    (scan_folder / "notes.txt").write_text("we walked around the table")
    (scan_folder / "cloud.ply").write_text("ply")
    (scan_folder / "associations.txt").write_text("0.1 rgb/0.png 0.1 depth/0.png\n")
    np.savez(
        scan_folder / "mono.npz", mtx=np.array([[30, 0, 15.5], [0, 30, 11.5], [0, 0, 1]]), dist=np.zeros(5)
    )
    assert list_warnings(scan_folder) == [
        "associations.txt looks like pairs of colour and depth images, which this layout does not need",
        "camera_path.txt looks like 3 poses: scan.poses=camera_path.txt",
        "cloud.ply looks like points or a mesh",
        "mono.npz looks like a camera calibration: scan.calibration=mono.npz",
        "other.json looks like a camera calibration: scan.calibration=other.json",
        "notes.txt",
    ]
    assert "camera_path.txt" not in " ".join(list_warnings(scan_folder, poses="camera_path.txt"))


def test_probing_files_emits_no_warnings(scan_folder):
    (scan_folder / "other.json").write_text(json.dumps({**CAMERA, "fy": 90}))
    with collecting() as read:
        scan = read_scan(scan_folder, complete=False)
    with collecting() as tried:
        assert [str(one) for one in find_unused_files(scan)] == [
            "other.json looks like a camera calibration: scan.calibration=other.json"
        ]
    assert not tried
    with collecting() as stated:
        read_scan(scan_folder, ScanParams(calibration=str(scan_folder / "other.json")), complete=False)
    assert CAMERA_CALIBRATION_CONTRADICTORY.name in [one.code for one in stated if one not in read]


def test_results_of_adjust_are_not_reported_as_camera(scan_folder):
    name = read_scan(scan_folder, complete=False).frames[0].name
    found = {"accepted": True, "color_camera": None, "color_from_depth": None}
    found |= {"names": {"0": name}, "poses": {"0": np.eye(4).tolist()}}
    (scan_folder / "cameras.json").write_text(json.dumps(found))
    assert list_warnings(scan_folder) == [
        "cameras.json looks like a result of adjust: scan.adjusted_cameras=cameras.json"
    ]


def test_many_files_of_a_kind_are_one_warning(scan_folder):
    (scan_folder / "masks").mkdir()
    for number in range(5):
        (scan_folder / "masks" / f"{number}.png").write_bytes(b"")
        (scan_folder / f"depth_picture_10{number}.jpg").write_bytes(b"")
    assert list_warnings(scan_folder) == [
        "depth_picture_*.jpg (5 files) looks like images",
        "masks/*.png (5 files) looks like masks: scan.masks=masks",
    ]


def test_a_camera_file_next_to_the_images_is_used(scan_folder):
    (scan_folder / "intrinsic.json").rename(scan_folder / "mine.json")
    assert list_warnings(scan_folder) == []


def test_inspect_reports_unused_files(scan_folder):
    for number in range(20):
        (scan_folder / f"log.{number}").write_text("")
    found = inspect(read_scan(scan_folder, complete=False))
    lines = [line for line in found.format_lines() if line.startswith("unused")]
    assert len(lines) == 13
    assert lines[-1] == "unused    and 8 more"
    assert found.to_dict()["unused"][0] == {"name": "log.0", "count": 1, "looks_like": ""}


def test_a_real_trajectory_with_an_unusual_name(shared_data, tmp_path):
    folder = shared_data / "real" / "freiburg3_cabinet_keyframes"
    assert list_warnings(folder) == []  # As many poses as frames, so the trajectory is used.
    name = "truth_cam_poses.txt"
    for one in folder.iterdir():
        if one.name != name:
            (tmp_path / one.name).symlink_to(one)
    (tmp_path / name).write_text("".join((folder / name).read_text().splitlines(keepends=True)[:57]))
    assert list_warnings(tmp_path) == [f"{name} looks like 57 poses: scan.poses={name}"]


def test_deeply_nested_files_and_link_cycles(scan_folder):
    deep = scan_folder / "logs" / "of" / "the day"
    deep.mkdir(parents=True)
    (deep / "way.tum").write_text("".join(f"{n} 0 0 {n} 0 0 0 1\n" for n in range(3)))
    (scan_folder / "logs" / "all of it").symlink_to(scan_folder, target_is_directory=True)
    (scan_folder / "again.tum").symlink_to(deep / "way.tum")
    (scan_folder / "itself.txt").symlink_to(scan_folder / "itself.txt")
    (told_once,) = list_warnings(scan_folder)
    assert told_once == "again.tum looks like 3 poses: scan.poses=again.tum"


def test_an_image_that_links_to_itself_is_ignored(scan_folder):
    path = scan_folder / "depth" / "1.png"
    path.unlink()
    path.symlink_to(path)
    scan = read_scan(scan_folder, complete=False)
    assert find_unused_files(scan) == ()
    assert [one.name for one in scan.frames] == ["0"]


def test_a_few_text_files_are_probed_individually(scan_folder):
    for number in range(6):
        (scan_folder / f"camera_{number}.json").write_text(json.dumps(CAMERA | {"fx": 30 + number}))
    assert len(list_warnings(scan_folder)) == 6
