"""Depth of real stereo pairs with ground truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.scans.model.images import read_color, read_right
from scanloom.stages.scans.model.scan import Camera, Frame, StereoRig
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.depth import DepthMap, depth, depth_scan


def read_pfm(path: Path) -> np.ndarray:
    with path.open("rb") as file:
        assert file.readline().strip() == b"Pf"
        width, height = map(int, file.readline().split())
        order = "<f4" if float(file.readline()) < 0 else ">f4"
        return np.flipud(np.frombuffer(file.read(), order).reshape(height, width))


def mask_visible(truth: np.ndarray) -> np.ndarray:
    """Mask the pixels whose true match in the right image is not occluded."""
    height, width = truth.shape
    rows, columns = np.nonzero(np.isfinite(truth))
    disparity = truth[rows, columns]
    target = np.round(columns - disparity).astype(int)
    inside = target >= 0
    rows, columns, disparity, target = (x[inside] for x in (rows, columns, disparity, target))
    nearest = np.full((height, width), -np.inf)
    np.maximum.at(nearest, (rows, target), disparity)
    seen = np.zeros((height, width), bool)
    seen[rows, columns] = disparity >= nearest[rows, target] - 1
    return seen


def assert_accuracy(result: DepthMap, truth: np.ndarray, *, wrong: float, covered: float) -> None:
    used, seen = result.depth > 0, mask_visible(truth)
    judged = used & np.isfinite(truth)
    assert np.mean(np.abs(result.disparity - truth)[judged] > 2) <= wrong
    assert np.mean(used[seen]) >= covered
    left = seen[:, : truth.shape[1] // 8]
    assert np.mean(used[:, : left.shape[1]][left]) >= covered - 0.1


def test_motorcycle(shared_data: Path) -> None:
    folder = shared_data / "stereo/middlebury2014_motorcycle"
    scan = read_scan(folder)
    (_, result), *rest = depth_scan(scan, matcher="3way")

    assert not rest
    assert isinstance(result, DepthMap)
    assert result.diagnostics == ()
    truth = read_pfm(folder / "disp0.pfm")
    assert_accuracy(result, truth, wrong=0.02, covered=0.85)
    # f 994.978 px, baseline 193.001 mm, doffs 31.086 px.
    z = 994.978 * 0.193001 / (truth + 31.086)
    used = (result.depth > 0) & np.isfinite(truth)
    assert np.median(np.abs(result.depth - z)[used] / z[used]) < 0.005


def test_cones(shared_data: Path) -> None:
    """The same matcher on another pair, with invented calibration."""
    result, truth = compute_cones_depth(shared_data, matcher="3way")
    assert_accuracy(result, truth, wrong=0.01, covered=0.85)


def compute_cones_depth(shared_data: Path, **changes: Any) -> tuple[DepthMap, np.ndarray]:
    """Compute depth of the pair; return its true disparity as well."""
    import cv2

    folder = shared_data / "stereo/middlebury2003_cones"
    left, right = (next(folder.glob(f"{name}.*")) for name in ("im2", "im6"))
    camera = Camera(450, 375, 600.0, 600.0, 224.5, 187.0)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -0.1
    frame = Frame("cones", camera, color=left, right=right)
    first, second = read_color(frame), read_right(frame)
    assert first is not None
    assert second is not None
    result = depth(first, second, StereoRig(camera, camera, right_from_left, is_rectified=True), **changes)
    truth = cv2.imread(str(folder / "disp2.pgm"), cv2.IMREAD_UNCHANGED) / 4.0
    truth[truth == 0] = np.inf
    return result, truth


def test_a_single_pair_covers_pixels_visible_in_both_images(shared_data: Path) -> None:
    """The own matcher covers nearly all pixels that both cameras see, with few errors."""
    folder = shared_data / "stereo/middlebury2014_motorcycle"
    (_, motorcycle), *_ = depth_scan(read_scan(folder))
    assert isinstance(motorcycle, DepthMap)
    for result, truth in ((motorcycle, read_pfm(folder / "disp0.pfm")), compute_cones_depth(shared_data)):
        seen = mask_visible(truth)
        given = result.depth > 0
        assert np.mean(given[seen]) > 0.95
        assert np.mean(np.abs(result.disparity - truth)[given & seen] > 2) < 0.0165


def test_pairs_of_a_street_are_covered(shared_data: Path) -> None:
    """KITTI 2015 with lidar ground truth: most of it is covered, with few errors above 3 px."""
    import cv2

    folder = shared_data / "real/kitti_stereo_2015"
    covered, wrong = [], []
    for place, name in enumerate(("000002_10", "000015_10", "000025_10", "000035_10")):
        (_, result), *_ = depth_scan(read_scan(folder, ScanParams(first=place, last=place)))
        assert isinstance(result, DepthMap)
        truth = cv2.imread(str(folder / f"disp_occ_0/{name}.png"), cv2.IMREAD_UNCHANGED) / 256.0
        given = (result.depth > 0) & (truth > 0)
        covered.append(np.count_nonzero(given) / np.count_nonzero(truth))
        wrong.append(np.mean(np.abs(result.disparity - truth)[given] > 3))
    assert np.mean(covered) > 0.85
    assert np.mean(wrong) < 0.03


def test_depth_of_a_street_is_consistent_between_frames(shared_data: Path) -> None:
    """Depth of one frame, transformed by the given poses, agrees with the depth of the next frame."""
    scan = read_scan(shared_data / "stereo/kitti_sequence_1")
    pairs = [scan.frames[i] for i in (8, 9)]
    (here, near), (there, far) = depth_scan(type(scan)(scan.layout, pairs, scan.rig), matcher="3way")
    assert isinstance(near, DepthMap)
    assert isinstance(far, DepthMap)
    assert here.world_from_camera is not None
    assert there.world_from_camera is not None

    camera = here.camera
    rows, columns = np.nonzero(near.depth)
    z = near.depth[rows, columns].astype(np.float64)
    points = np.stack(
        [(columns - camera.cx) / camera.fx * z, (rows - camera.cy) / camera.fy * z, z, z * 0 + 1]
    )
    moved = np.linalg.inv(there.world_from_camera) @ here.world_from_camera @ points
    moved = moved[:, moved[2] > 1]
    u = np.round(camera.fx * moved[0] / moved[2] + camera.cx).astype(int)
    v = np.round(camera.fy * moved[1] / moved[2] + camera.cy).astype(int)
    inside = (u >= 0) & (u < camera.width) & (v >= 0) & (v < camera.height)
    expected = camera.fx * 0.5371 / moved[2, inside]
    measured = far.depth[v[inside], u[inside]]
    difference = np.abs(expected - camera.fx * 0.5371 / np.where(measured > 0, measured, np.nan))
    difference = difference[np.isfinite(difference)]
    assert len(difference) > 80_000
    assert np.median(difference) < 0.4
    assert np.mean(difference > 1) < 0.08
    # The road: its lower middle part is nearly complete in a single frame.
    assert np.mean(near.depth[280:360, 450:750] > 0) > 0.85


def test_an_unrectified_room_is_rectified(shared_data: Path) -> None:
    scan = read_scan(shared_data / "stereo/euroc_V1_01_easy_static")
    assert scan.rig is not None
    assert not scan.rig.is_rectified
    (frame, result), *_ = depth_scan(type(scan)(scan.layout, scan.frames[:1], scan.rig))

    assert isinstance(result, DepthMap)
    assert result.diagnostics == ()
    assert frame.camera.distortion == ()
    assert np.mean(result.depth > 0) > 0.65
    # The floor in front of the rig is a plane, with a noise of a quarter of a pixel at 2 m.
    part = result.disparity[300:420, 150:350]
    rows, columns = np.nonzero(result.depth[300:420, 150:350])
    plane = np.column_stack([rows, columns, np.ones(len(rows))])
    fit, *_ = np.linalg.lstsq(plane, part[rows, columns], rcond=None)
    assert np.median(np.abs(plane @ fit - part[rows, columns])) < 0.25
