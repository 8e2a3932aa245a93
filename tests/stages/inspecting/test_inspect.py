import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.fusion.fuse import fuse
from scanloom.stages.inspecting.codes import POSE_INEXACT
from scanloom.stages.inspecting.consistency_checks import check_poses, require_poses, warn_inexact_poses
from scanloom.stages.inspecting.inspect import inspect
from scanloom.stages.inspecting.inspection import Inspection
from scanloom.stages.scans.codes import CAMERA_PAIR_UNCALIBRATED, POSE_MISSING
from scanloom.stages.scans.model.images import read_color
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.scans.params import ScanParams
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.codes import DEPTH_PAIR_ROWS_DIFFER, DEPTH_PAIR_SWAPPED

CAMERA = Camera(160, 120, 150, 150, 80, 60)
FLIP = np.diag((1.0, -1, -1, 1))


def make_pose(x, z, degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, 0, s, x], [0, 1, 0, 0], [-s, 0, c, z], [0, 0, 0, 1.0]])


def render_room_depth(pose, camera=CAMERA):
    """Compute the depth inside a box of 3 x 2 x 4 m around the origin by ray-plane intersection."""
    v, u = np.mgrid[: camera.height, : camera.width]
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u, float)], -1)
    directions = rays @ pose[:3, :3].T
    with np.errstate(divide="ignore", invalid="ignore"):
        distances = (np.sign(directions) * (1.5, 1.0, 2.0) - pose[:3, 3]) / directions
    return np.where(np.isfinite(distances), distances, np.inf).min(axis=-1).astype(np.float32)


def make_room_scan(change=lambda pose: pose):
    poses = [make_pose(0.1 * i, 0.05 * i, 4 * i) for i in range(8)]
    frames = [
        Frame(str(i), CAMERA, depth=render_room_depth(pose), world_from_camera=change(pose))
        for i, pose in enumerate(poses)
    ]
    return Scan("plain-rgbd", frames)


def test_true_poses_agree_without_warning():
    found = inspect(make_room_scan())
    assert found.pose_errors_m["as given"] < 0.01
    assert found.diagnostics == ()


@pytest.mark.parametrize(
    ("change", "name"),
    [
        (np.linalg.inv, "world-to-camera"),
        (lambda pose: pose @ FLIP, "in camera axes with y up and z back"),
        (lambda pose: np.linalg.inv(pose @ FLIP), "world-to-camera in axes with y up and z back"),
    ],
)
def test_another_pose_convention_is_recognised(change, name):
    found = inspect(make_room_scan(change))
    assert any(f"probably {name}:" in text for text in map(str, found.diagnostics))
    assert min(found.pose_errors_m, key=found.pose_errors_m.get) == name


def test_another_pose_convention_is_an_error_for_fusion():
    require_poses(make_room_scan())
    with pytest.raises(InputError, match=r"probably world-to-camera.*mm as given; \d+ mm world-to-camera"):
        require_poses(make_room_scan(np.linalg.inv))


def test_reversed_poses_are_recognised():
    # Accelerated motion: for uniform motion, reversed poses are indistinguishable from inverted ones.
    poses = [make_pose(0.02 * i**2, 0.05 * i, 4 * i + i**2 / 4) for i in range(8)]
    frames = [
        Frame(str(i), CAMERA, depth=render_room_depth(pose), world_from_camera=given)
        for i, (pose, given) in enumerate(zip(poses, reversed(poses), strict=True))
    ]
    with pytest.raises(InputError, match=r"in reverse frame order: overlapping"):
        require_poses(Scan("plain-rgbd", frames))


def test_poses_that_fit_two_conventions_are_reported_with_both():
    """A camera in uniform motion, like around a turntable."""
    poses = [np.linalg.matrix_power(make_pose(0.1, 0.0, 5.0), i) for i in range(8)]
    frames = [
        Frame(str(i), CAMERA, depth=render_room_depth(pose), world_from_camera=np.linalg.inv(pose))
        for i, pose in enumerate(poses)
    ]
    errors, suspicion = check_poses(frames)
    assert "probably world-to-camera, or in reverse frame order: overlapping" in str(suspicion)
    assert errors["as given"] > 0.05


def test_frames_without_a_pose_do_not_affect_the_others():
    scan = make_room_scan()
    lost = [replace(frame, world_from_camera=None) for frame in scan.frames[::2]]
    frames = [lost[i // 2] if i % 2 == 0 else frame for i, frame in enumerate(scan.frames)]
    errors, suspicion = check_poses(frames)
    assert errors["as given"] < 0.01
    assert suspicion is None


def test_inexact_poses_are_distinguished_from_noise():
    numbers = np.random.default_rng(5)
    noisy = [
        replace(frame, depth=(frame.depth * numbers.normal(1, 0.01, frame.depth.shape)).astype(np.float32))
        for frame in make_room_scan().frames
    ]
    warn_inexact_poses(noisy)
    shaken = make_room_scan(lambda pose: pose @ make_pose(*numbers.normal(0, 0.03, 2), numbers.normal(0, 1)))
    with collecting() as diagnostics:
        warn_inexact_poses(shaken.frames)
    (doubt,) = diagnostics
    assert doubt.code == POSE_INEXACT.name
    assert "register.refine=true" in str(doubt)
    assert doubt in inspect(shaken).diagnostics


def test_random_poses_are_not_reported_as_another_convention():
    numbers = np.random.default_rng(3)
    drifting = make_room_scan(lambda _: make_pose(*numbers.uniform(-0.5, 0.5, 2), numbers.uniform(-40, 40)))
    require_poses(drifting)


def test_a_nearly_static_camera_raises_no_warning():
    numbers = np.random.default_rng(4)
    frames = [
        Frame(
            str(i),
            CAMERA,
            depth=render_room_depth(make_pose(0.0001 * i, 0, 0))
            + numbers.normal(0, 0.01, (120, 160)).astype(np.float32),
            world_from_camera=make_pose(-0.0001 * i, 0, 0),
        )
        for i in range(8)
    ]
    require_poses(Scan("x", frames))


def test_the_path_is_measured():
    frames = [
        Frame(str(i), CAMERA, depth=render_room_depth(np.eye(4)), world_from_camera=make_pose(x, 0, turn))
        for i, (x, turn) in enumerate([(0, 0), (0.1, 0), (0.3, 10), (1.3, 10), (1.3, 60)])
    ]
    path = inspect(Scan("plain-rgbd", frames)).trajectory
    assert path.length_m == pytest.approx(1.3)
    assert path.box_m == pytest.approx((1.3, 0, 0))
    assert path.max_step_m == pytest.approx(1)
    assert path.max_rotation_deg == pytest.approx(50)
    assert path.outliers == ("3", "4")


def test_depth_is_summarised():
    depth = np.full((120, 160), 1.5, np.float32)
    depth[:30] = 0
    scan = Scan("plain-rgbd", [Frame("a", CAMERA, depth=depth, world_from_camera=np.eye(4))])
    found = inspect(scan)
    assert (found.depth.near_m, found.depth.median_m, found.depth.far_m) == (1.5, 1.5, 1.5)
    assert found.depth.missing_ratio == pytest.approx(0.25)


def test_depth_without_values_is_reported():
    depth = np.zeros((120, 160), np.float32)
    poses = (make_pose(0, 0, 0), make_pose(0.1, 0, 0))
    found = inspect(Scan("x", [Frame("a", CAMERA, depth=depth, world_from_camera=pose) for pose in poses]))
    assert found.depth is None
    assert found.pose_errors_m == {}
    assert any("all are 0 or missing" in text for text in map(str, found.diagnostics))


@pytest.fixture
def depth_files(tmp_path):
    frames = []
    for i in range(4):
        pose = make_pose(0.1 * i, 0, 3 * i)
        path = tmp_path / f"{i}.png"
        cv2.imwrite(str(path), (render_room_depth(pose) * 5000).astype(np.uint16))
        frames.append(Frame(str(i), CAMERA, depth=path, depth_scale=5000, world_from_camera=pose))
    return frames


def test_a_wrong_depth_scale_is_reported_with_the_right_one(depth_files):
    frames = [replace(frame, depth_scale=100.0) for frame in depth_files]
    (warning,) = (text for text in map(str, inspect(Scan("x", frames)).diagnostics) if "median depth" in text)
    assert "5000 (TUM RGB-D)" in warning


def test_a_marker_for_missing_depth_is_found(depth_files):
    for frame in depth_files:
        raw = cv2.imread(str(frame.depth), cv2.IMREAD_UNCHANGED)
        raw[:10] = 65535
        cv2.imwrite(str(frame.depth), raw)
    assert any("65535" in text for text in map(str, inspect(Scan("x", depth_files)).diagnostics))
    known = [replace(frame, depth_missing=(65535,)) for frame in depth_files]
    assert not any("65535" in text for text in map(str, inspect(Scan("x", known)).diagnostics))


def test_unusual_and_damaged_files_are_counted(depth_files):
    cv2.imwrite(str(depth_files[1].depth), np.ones((10, 10), np.uint16))
    depth_files[2].depth.write_bytes(b"nothing")
    warnings = "\n".join(map(str, inspect(Scan("x", depth_files)).diagnostics))
    assert "another size (10×10), the first is 1.png" in warnings
    assert "cannot be read, the first is 2.png" in warnings


def test_a_scan_without_readable_depth_is_an_error(depth_files):
    for frame in depth_files:
        frame.depth.write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"0\.png"):
        inspect(Scan("x", depth_files))


def make_textured_pair(disparity, rows=0):
    scene = cv2.GaussianBlur(np.random.default_rng(1).integers(0, 255, (260, 440), np.uint8), (0, 0), 2)
    scene = cv2.normalize(scene, None, 0, 255, cv2.NORM_MINMAX)
    left = scene[10:250, 40:360]
    right = scene[10 + rows : 250 + rows, 40 + disparity : 360 + disparity]
    return [np.ascontiguousarray(np.dstack([image] * 3)) for image in (left, right)]


def inspect_stereo(left, right):
    camera = Camera(320, 240, 300, 300, 160, 120)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -0.1
    rig = StereoRig(camera, camera, right_from_left, is_rectified=True, disparity_count=30)
    return inspect(Scan("x", [Frame("a", camera, color=left, right=right, world_from_camera=np.eye(4))], rig))


def test_a_sound_pair_raises_no_warning():
    found = inspect_stereo(*make_textured_pair(12))
    assert found.diagnostics == ()
    assert found.stereo_depth_m == pytest.approx((1.0, 30.0))
    assert not any(line.startswith("path") for line in found.format_lines())


def test_swapped_stereo_images_are_detected():
    (diagnostic,) = inspect_stereo(*reversed(make_textured_pair(12))).diagnostics
    assert diagnostic.code == DEPTH_PAIR_SWAPPED.name
    assert "swapped" in str(diagnostic)


def test_row_offsets_of_stereo_images_are_detected():
    found = inspect_stereo(*make_textured_pair(12, rows=3))
    assert [one.code for one in found.diagnostics] == [DEPTH_PAIR_ROWS_DIFFER.name]
    assert "3.0 rows" in str(found.diagnostics[0])


def make_blocks(seed, shift):
    """Make depth with blocks, and a colour image of the blocks shifted to the right by `shift` pixels."""
    numbers = np.random.default_rng(seed).integers(0, 5, (6, 8))
    depth = np.kron(1 + 0.4 * numbers, np.ones((20, 20))).astype(np.float32)
    grey = np.roll(np.kron(50 * numbers, np.ones((20, 20))), shift, axis=1).astype(np.uint8)
    return np.dstack([grey] * 3), depth


@pytest.mark.parametrize(
    ("shift", "words"),
    [(0, None), (5, r"5\.[01] px to the right and 0\.[01] px"), (-4, r"4\.[01] px to the left")],
)
def test_an_offset_between_colour_and_depth_is_detected(shift, words):
    frames = [
        Frame("a", CAMERA, color=color, depth=depth, world_from_camera=np.eye(4))
        for color, depth in (make_blocks(seed, shift) for seed in (2, 3))
    ]
    scan = Scan("x", frames)
    said = [text for text in map(str, inspect(scan).diagnostics) if "not registered" in text]
    assert bool(said) == (words is not None)
    assert words is None or re.search(words, said[0])


@cache
def inspect_folder(folder: Path, **options) -> Inspection:
    """Inspect a real folder; the result is cached, because two tests use it."""
    return inspect(read_scan(folder, ScanParams(**options)))


@pytest.mark.parametrize(
    ("folder", "options"),
    [
        ("rgbd/7scenes_redkitchen", {}),
        ("rgbd/tabletop_box_realsense", {}),
        ("rgbd/open3d_testdata/RGBD", {}),
        ("stereo/kitti_sequence_1", {}),
        ("stereo/middlebury2014_motorcycle", {}),
        ("stereo/euroc_V1_01_easy_static", {}),
        ("stereo/middlebury2003_cones", {"intrinsics": "1000,1000,225,187", "baseline": 0.16}),
    ],
)
def test_real_scans_raise_no_warnings(shared_data, folder, options):
    found = inspect_folder(shared_data / folder, **options)
    for fault in (
        "probably",
        "exchanged",
        "rectified images, but",
        "median depth",
        "jump",
        "cannot be",
        "size",
    ):
        assert not any(fault in text for text in map(str, found.diagnostics)), found.diagnostics
    metrics = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert metrics["frames"] == len(found.scan.frames)
    if not found.scan.is_stereo:
        assert found.pose_errors_m["as given"] < 0.015
        assert min(found.pose_errors_m, key=found.pose_errors_m.get) == "as given"
    assert any(line.startswith("layout") for line in found.format_lines())


def test_shifted_colour_is_detected_on_real_frames(shared_data):
    scan = read_scan(shared_data / "rgbd" / "open3d_testdata" / "RGBD")
    moved = [replace(frame, color=np.roll(read_color(frame), (0, 6), axis=(0, 1))) for frame in scan.frames]
    said = list(map(str, inspect(replace(scan, frames=moved)).diagnostics))
    assert any(re.search(r"(5\.[789]|6\.[012]) px to the right and 0\.\d px", text) for text in said)


def test_a_wrong_colour_camera_is_reported(shared_data):
    said = list(map(str, inspect_folder(shared_data / "rgbd" / "tabletop_box_realsense").diagnostics))
    assert any(
        "not registered to depth: judged by silhouettes, the photos are shifted 4." in text for text in said
    )


@pytest.mark.parametrize(
    ("folder", "frames", "size", "missing"),
    [
        ("rgbd/realsense_desk_tum_layout", 25, (640, 480), ["poses: groundtruth.txt is missing"]),
        ("stereo/middlebury2003_cones", 1, (450, 375), ["calibration: calibration.json is missing"]),
    ],
)
def test_missing_data_of_a_real_scan_is_reported(shared_data, folder, frames, size, missing):
    with pytest.raises(InputError, match=f"no {missing[0]}"):
        read_scan(shared_data / folder)
    found = inspect(read_scan(shared_data / folder, complete=False))
    metrics = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    assert metrics["frames"] == frames
    assert tuple(metrics["color_size_px"]) == size
    assert [one["message"] for one in metrics["missing"]] == [f"no {text}" for text in missing]
    assert [line for line in found.format_lines() if line.startswith(f"missing   no {missing[0]}")]


def test_a_street_without_poses_and_calibration(shared_data, tmp_path):
    street = shared_data / "stereo" / "kitti_sequence_1"
    for name, source in (("image_0", "image_l"), ("image_1", "image_r")):
        (tmp_path / name).symlink_to(street / source)
    found = inspect(read_scan(tmp_path, complete=False))
    metrics = json.loads(json.dumps(found.to_dict(), allow_nan=False))
    codes = [one["code"] for one in metrics["missing"]]
    assert codes == [CAMERA_PAIR_UNCALIBRATED.name, POSE_MISSING.name]
    assert (metrics["frames"], metrics["rig"], metrics["path"]) == (41, None, None)
    with pytest.raises(InputError, match=r"no calibration: calib\.txt.*; and no poses: poses\.txt"):
        read_scan(tmp_path)


def test_the_depth_range_of_a_real_kitchen(shared_data):
    depth = inspect_folder(shared_data / "rgbd" / "7scenes_redkitchen").depth
    assert 0.5 < depth.near_m < depth.median_m < depth.far_m < 5


def make_stripes(blur):
    """Make stripes of four pixels, blurred by a box filter of `blur` pixels."""
    image = np.zeros((120, 160, 3), np.uint8)
    image[:, ::4] = image[:, 1::4] = 200
    return image if blur == 0 else cv2.blur(image, (blur, blur))


def test_the_blurriest_5_percent_of_frames_are_listed():
    frames = list(make_room_scan().frames) * 5
    blurs = {7: 4, 20: 3}
    frames = [replace(f, name=str(i), color=make_stripes(blurs.get(i, 0))) for i, f in enumerate(frames)]
    found = inspect(Scan("plain-rgbd", frames))
    # Two of forty; a filter as long as the period removes all contrast.
    assert [name for name, _ in found.blurriest_frames] == ["7", "20"]
    assert found.blurriest_frames[0][1] < 0.05 < found.blurriest_frames[1][1] < 0.25
    assert any("blurred" in text and "7, 20" in text for text in map(str, found.diagnostics))
    assert found.to_dict()["blurriest_frames"][0]["frame"] == "7"


def test_equally_sharp_frames_raise_no_warning():
    frames = [replace(frame, color=make_stripes(0)) for frame in make_room_scan().frames]
    found = inspect(Scan("plain-rgbd", frames))
    assert [value for _, value in found.blurriest_frames] == [1.0]
    assert not any("blurred" in text for text in map(str, found.diagnostics))


def test_fusion_uses_the_estimates_of_inspect():
    scan = make_room_scan()
    expected = inspect(scan).fusion_estimate
    fused = fuse(scan)
    assert expected.voxel_size_m == fused.voxel_size
    assert 0.5 < fused.volume_bytes / 1e6 / expected.volume_mb <= 1.05
    assert 0.5 < len(fused.mesh.triangles) / expected.triangles < 2


def test_without_poses_there_is_no_fusion_estimate():
    frames = [replace(frame, world_from_camera=None) for frame in make_room_scan().frames]
    found = inspect(Scan("plain-rgbd", frames, missing=(POSE_MISSING.warning("no poses: none"),)))
    assert found.fusion_estimate is None
    assert "missing   no poses: none; `scanloom run` estimates them" in found.format_lines()


def test_a_single_frame_has_no_blur_ranking():
    (frame, *_) = make_room_scan().frames
    assert inspect(Scan("plain-rgbd", [replace(frame, color=make_stripes(0))])).blurriest_frames == ()


def test_several_image_sizes_are_one_warning(depth_files):
    for size, frame in ((10, depth_files[0]), (12, depth_files[1])):
        cv2.imwrite(str(frame.depth), np.ones((size, size), np.uint16))
    warnings = list(map(str, inspect(Scan("x", depth_files)).diagnostics))
    assert not any("another size" in text for text in warnings)
    (told,) = (text for text in warnings if "other sizes" in text)
    assert told.startswith("2 depth images have 2 other sizes (10×10, 12×12) than most")


@pytest.mark.parametrize("true_scale", [10000, 5000, 80000])
def test_a_wrong_depth_scale_is_found_from_poses(true_scale):
    frames = [
        replace(frame, depth=frame.depth * (true_scale / 1000), depth_scale=1000.0)
        for frame in make_room_scan().frames
    ]
    warnings = list(map(str, inspect(Scan("x", frames)).diagnostics))
    (told,) = (text for text in warnings if "depth_scale" in text)
    assert told.startswith(f"the depth unit is probably wrong: with scan.depth_scale={true_scale}, ")


def test_a_rotating_camera_gives_no_depth_scale():
    poses = [make_pose(0, 0, 4 * i) for i in range(8)]
    frames = [
        Frame(str(i), CAMERA, depth=render_room_depth(pose) * 10, world_from_camera=pose)
        for i, pose in enumerate(poses)
    ]
    assert not any(
        "depth unit is probably wrong" in text for text in map(str, inspect(Scan("x", frames)).diagnostics)
    )
