import numpy as np
import pytest

from scanloom.pipeline.cache.digest import compute_scan_digest
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

CAMERA = "100 0 16 0 100 12 0 0 1"
# World-to-camera of the two frames of the tiny world: R and t by hand, R = pose.T, t = -R c.
FIRST = f"a0001.png {CAMERA} 1 0 0 0 1 0 0 0 1 0 0 0"
SECOND = f"a0002.png {CAMERA} 0 0 -1 0 1 0 1 0 0 3 -2 -1"
PAR = f"2\n{FIRST}\n{SECOND}\n"
NOTES = "two views\n\nThe (tight) bounding box for the model is\n(-1 0.5 2)\n(3.5 2.5 4)\n"


@pytest.fixture
def scan_folder(tmp_path, tiny):
    tiny.color(tmp_path / "a0001.png")
    tiny.color(tmp_path / "a0002.png")
    (tmp_path / "a_par.txt").write_text(PAR)
    return tmp_path


def test_the_known_points_fall_on_the_known_pixel(scan_folder, tiny):
    scan = read_scan(scan_folder)
    assert (scan.layout, scan.rig, scan.is_stereo, scan.is_views) == ("middlebury-mview", None, False, True)
    assert [frame.name for frame in scan.frames] == ["a0001", "a0002"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        assert frame.depth is None
        pixel = tiny.pixel(point, np.linalg.inv(frame.world_from_camera), frame.camera)
        np.testing.assert_allclose(pixel, (26, 17), atol=1e-9)
    np.testing.assert_allclose(scan.frames[1].world_from_camera, tiny.second, atol=1e-12)


def test_the_box_of_the_notes_is_read_and_is_part_of_the_digest(scan_folder):
    without = read_scan(scan_folder)
    assert without.bounding_box is None
    (scan_folder / "README.txt").write_text(NOTES)
    scan = read_scan(scan_folder)
    np.testing.assert_array_equal(scan.bounding_box, [[-1, 0.5, 2], [3.5, 2.5, 4]])
    assert compute_scan_digest(scan).digest != compute_scan_digest(without).digest


@pytest.mark.parametrize(
    "notes",
    [
        b"the bounding box is unknown",
        NOTES.replace("3.5", "-3.5").encode(),
        NOTES.replace("3.5", "nan").encode(),
        NOTES.replace("3.5", "x").encode(),
        NOTES.replace("3.5", "3e300").encode(),
        NOTES.replace(" 2.5", "").encode(),
        b"\xff\xfe bounding box",
    ],
)
def test_notes_that_state_no_sound_box_are_passed_over(scan_folder, notes):
    (scan_folder / "README.txt").write_bytes(notes)
    assert read_scan(scan_folder).bounding_box is None


def test_without_its_count_a_file_is_read_as_well(scan_folder):
    (scan_folder / "a_par.txt").write_text(f"{FIRST}\n{SECOND}\n")
    assert len(read_scan(scan_folder).frames) == 2


def test_an_image_that_is_not_there_is_left_out(scan_folder):
    (scan_folder / "a0001.png").unlink()
    scan = read_scan(scan_folder)
    assert [frame.name for frame in scan.frames] == ["a0002"]
    assert scan.skipped_frames[0].name == "a0001"


def test_stated_values_win(scan_folder, tiny):
    poses = "\n".join(" ".join(map(str, pose.ravel())) for pose in (tiny.second, tiny.identity))
    (scan_folder / "poses.txt").write_text(poses)
    scan = read_scan(scan_folder, ScanParams(intrinsics="50,51,15,11", poses="poses.txt"))
    assert (scan.frames[0].camera.fx, scan.frames[0].camera.fy) == (50, 51)
    np.testing.assert_allclose(scan.frames[0].world_from_camera, tiny.second)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no images"),
        (PAR.replace("2\n", "3\n", 1), "states 3 images but lists 2"),
        (PAR[:-20], "line 3 .*21 numbers"),
        (PAR.replace(" -1\n", " x\n"), "line 3 .*21 numbers"),
        (PAR.replace("100 0 16", "100 5 16", 1), "skew"),
        (PAR.replace("100 0 16", "-100 0 16", 1), "focal length"),
        (PAR.replace("100 0 16", "nan 0 16", 1), "not finite"),
        (PAR.replace("1 0 0 0 1 0 0 0 1 0 0 0", "1 0 0 0 1 0 0 0 -1 0 0 0", 1), "mirrors"),
        (PAR.replace("1 0 0 0 1 0 0 0 1 0 0 0", "2 0 0 0 2 0 0 0 2 0 0 0", 1), "not a rotation"),
        (PAR.replace("a0002.png", "../a0002.png"), "not the name of an image"),
    ],
)
def test_damaged_camera_files_are_reported(scan_folder, text, message):
    (scan_folder / "a_par.txt").write_text(text)
    with pytest.raises(InputError, match=rf"a_par\.txt.*{message}"):
        read_scan(scan_folder)


def test_two_camera_files_are_ambiguous(scan_folder):
    (scan_folder / "b_par.txt").write_text(PAR)
    with pytest.raises(InputError, match="the folder has 2"):
        read_scan(scan_folder)


def test_temple_ring(shared_data):
    scan = read_scan(shared_data / "stereo" / "middlebury_templeRing")
    assert (scan.layout, len(scan.frames)) == ("middlebury-mview", 47)
    camera = scan.frames[0].camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (1520.4, 1525.9, 302.32, 246.87)
    np.testing.assert_allclose(scan.bounding_box[1], (0.078626, 0.121636, -0.017395))
    middle = scan.bounding_box.mean(axis=0)
    for frame in scan.frames:
        # All cameras are on a ring of 0.57 m around the object and face its centre.
        seen = frame.world_from_camera[:3, :3].T @ (middle - frame.world_from_camera[:3, 3])
        assert 0.55 < seen[2] < 0.59
        assert np.hypot(*seen[:2]) < 0.03


@pytest.mark.parametrize("name", ["a\0b.png", "a" * 300 + ".png", "/etc/hosts", ".."])
def test_names_that_no_file_can_have_are_refused(tmp_path, name):
    row = f"{name} 100 0 16 0 100 12 0 0 1 1 0 0 0 1 0 0 0 1 0 0 0\n"
    (tmp_path / "x_par.txt").write_text(f"1\n{row}", encoding="utf-8")
    with pytest.raises(InputError, match="is not"):
        read_scan(tmp_path, complete=False)
