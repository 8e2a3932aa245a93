import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.model.images import read_mask
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan


def row(pose, size=(32, 24), focal=100.0, bounds=(1.0, 4.0)):
    """Make the 17 numbers of a pose.

    Axes (down, right, back), position, h, w, f, nearest and farthest depth.
    """
    right, down, forward = pose[:3, :3].T
    table = np.column_stack([down, right, -forward, pose[:3, 3], (size[1], size[0], focal)])
    return [*table.ravel(), *bounds]


@pytest.fixture
def scan_folder(tmp_path, tiny):
    for name in ("IMG_2", "IMG_10"):
        tiny.color(tmp_path / "images" / f"{name}.JPG")
    # In alphabetical order, IMG_10 comes first.
    np.save(tmp_path / "poses_bounds.npy", [row(tiny.second), row(tiny.identity)])
    return tmp_path


def test_known_points_fall_on_known_pixels(scan_folder, tiny):
    scan = read_scan(scan_folder, ScanParams(intrinsics=tiny.option))
    assert (scan.layout, scan.is_views, scan.is_metric) == ("llff", True, False)
    assert [frame.name for frame in scan.frames] == ["IMG_10", "IMG_2"]
    for frame, point in zip(scan.frames, tiny.points[::-1], strict=True):
        at = tiny.pixel(point, np.linalg.inv(frame.world_from_camera), frame.camera)
        np.testing.assert_allclose(at, (26, 17), atol=1e-6)


def test_the_camera_and_the_range_are_those_of_the_row(scan_folder):
    frame = read_scan(scan_folder).frames[0]
    camera = frame.camera
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (100, 100, 15.5, 11.5)
    assert frame.depth_range == pytest.approx((1 / 1.1, 4.4))
    metric = read_scan(scan_folder, ScanParams(depth_scale=2.0))
    assert metric.is_metric
    np.testing.assert_allclose(metric.frames[0].world_from_camera[:3, 3], (0.5, 1, 1.5))


def test_photos_made_smaller_keep_their_rows(scan_folder, tiny):
    (scan_folder / "images").rename(scan_folder / "originals")
    for name in ("IMG_2", "IMG_10"):
        tiny.color(scan_folder / "images_2" / f"{name}.png", (16, 12))
    assert read_scan(scan_folder).frames[0].camera.fx == 50


def test_masks_next_to_the_photos(scan_folder):
    (scan_folder / "masks").mkdir()
    mask = np.zeros((24, 32), np.uint8)
    mask[5:15, 5:25] = 255
    mask[0, 0] = 3  # JPEG compression does not keep exact black
    assert cv2.imwrite(str(scan_folder / "masks" / "IMG_2_mask.png"), mask)
    first, second = read_scan(scan_folder).frames
    assert first.mask is None
    np.testing.assert_array_equal(read_mask(second), np.where(mask > 128, 255, 0))


def test_rows_that_are_no_views(scan_folder):
    file = scan_folder / "poses_bounds.npy"
    np.save(file, np.zeros((2, 16)))
    with pytest.raises(
        InputError, match=r"rows of 17 numbers are expected, but the array has shape \(2, 16\)"
    ):
        read_scan(scan_folder)
    np.save(file, np.zeros((3, 17)))
    with pytest.raises(InputError, match="it holds 3 rows, but the scan has 2 frames"):
        read_scan(scan_folder)
    file.write_bytes(b"nothing of numpy's")
    with pytest.raises(InputError, match="the table of poses cannot be read"):
        read_scan(scan_folder)


def test_a_real_turntable(shared_data):
    scan = read_scan(shared_data / "real" / "llff_tankard_masks")
    assert (len(scan.frames), scan.frames[0].camera.fx) == (8, pytest.approx(10547.244, abs=1e-3))
    # All cameras face one point, about 4 units away.
    forwards = [frame.world_from_camera[:3, 2] for frame in scan.frames]
    centres = [frame.world_from_camera[:3, 3] for frame in scan.frames]
    lines = [np.eye(3) - np.outer(one, one) for one in forwards]
    middle = np.linalg.solve(sum(lines), sum(a @ c for a, c in zip(lines, centres, strict=True)))
    for forward, centre in zip(forwards, centres, strict=True):
        assert 3 < forward @ (middle - centre) < 5
    shown = np.mean(read_mask(scan.frames[0]) > 0)
    assert 0.4 < shown < 0.55
