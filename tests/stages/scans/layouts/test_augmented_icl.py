import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan

TOGETHER = (".", ".", "livingroom1.log")
APART = ("livingroom1-color", "livingroom1-depth-clean", "livingroom1-traj.txt")


def written(folder, tiny, matrix_text, names):
    colors, depths, log = names
    for number in (0, 2):
        tiny.color(folder / colors / f"{number:05d}.jpg")
        tiny.depth(folder / depths / f"{number:05d}.png", 1000)
    poses = (tiny.identity, np.eye(4), tiny.second)
    (folder / log).write_text(
        "".join(f"{i} {i} {i + 1}\n" + matrix_text(pose) for i, pose in enumerate(poses))
    )
    return folder


@pytest.mark.parametrize("names", [TOGETHER, APART])
def test_known_points_come_out_in_the_world(tmp_path, tiny, matrix_text, names):
    scan = read_scan(written(tmp_path, tiny, matrix_text, names), ScanParams(intrinsics=tiny.option))
    assert scan.layout == "augmented-icl"
    assert [frame.name for frame in scan.frames] == ["00000", "00002"]
    for frame, point in zip(scan.frames, tiny.points, strict=True):
        assert (frame.color.suffix, frame.depth.suffix) == (".jpg", ".png")
        np.testing.assert_allclose(tiny.seen(frame), point, atol=1e-6)


def test_the_camera_is_the_known_one_of_the_data_set(tmp_path, tiny, matrix_text):
    camera = read_scan(written(tmp_path, tiny, matrix_text, APART)).frames[0].camera
    np.testing.assert_allclose((camera.fx, camera.fy, camera.cx, camera.cy), (26.25, 26.25, 15.5, 11.5))


def test_clean_depth_has_priority_over_simulated_depth(tmp_path, tiny, matrix_text):
    written(tmp_path, tiny, matrix_text, APART)
    tiny.depth(tmp_path / "livingroom1-depth-simulated" / "00000.png", 1000)
    assert read_scan(tmp_path).frames[0].depth.parent.name == "livingroom1-depth-clean"


@pytest.mark.parametrize(
    "text", ["", "0 0 1\n1 0 0\n", "0 0 1\n" + "2 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n", "x"]
)
def test_a_wrong_trajectory_is_refused(tmp_path, tiny, matrix_text, text):
    written(tmp_path, tiny, matrix_text, TOGETHER)
    (tmp_path / "livingroom1.log").write_text(text)
    with pytest.raises(InputError, match=r"livingroom1\.log"):
        read_scan(tmp_path)


def test_photos_without_a_trajectory_are_no_scan(tmp_path, tiny, matrix_text):
    written(tmp_path, tiny, matrix_text, TOGETHER)
    (tmp_path / "livingroom1.log").unlink()
    with pytest.raises(InputError, match="unknown layout"):
        read_scan(tmp_path)
