"""Depth of posed photos, on a synthetic scene with known depth and on a real scene."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import posed_scene
import pytest
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from scanloom import read_scan, views_depth
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.features import detect_keypoints, match_descriptors
from scanloom.stages.scans.codes import POSE_INCONSISTENT_WITH_IMAGES
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, SkippedFrame
from scanloom.stages.stereo.background import mask_textured_surroundings
from scanloom.stages.stereo.codes import DEPTH_COVERAGE_LOW, DEPTH_IMAGES_TURNED, DEPTH_POSES_MOVED
from scanloom.stages.stereo.depth import DepthMap, DepthParams
from scanloom.stages.stereo.depth_ranges import assign_depth_ranges, estimate_scene_box
from scanloom.stages.stereo.partner_selection import score_partner, select_partners
from scanloom.stages.stereo.posed_views import PosedView, create_posed_views
from scanloom.stages.stereo.triangulation import find_overlapping_pairs, match_views
from scanloom.stages.stereo.view_consistency import count_supporting_views, merge_depth_maps
from scanloom.stages.stereo.view_rectification import rectify_views, transfer_depth

pytestmark = pytest.mark.slow


def make_view(pose: np.ndarray, near: float = 0.8, far: float = 1.6) -> PosedView:
    return PosedView(posed_scene.CAMERA, pose, near, far)


def make_ring(*angles: float) -> list[PosedView]:
    return [make_view(posed_scene.pose(angle, 0)) for angle in angles]


@cache
def compute_depth_of_scene() -> tuple[list[tuple[Frame, DepthMap | SkippedFrame]], list[tuple[int, int]]]:
    """Compute depth of the made scene with its progress; cached, because several tests use it."""
    told: list[tuple[int, int]] = []
    found = views_depth(
        posed_scene.make_posed_scan()[0], DepthParams(), lambda done, total: told.append((done, total))
    )
    return list(found), told


def get_depth_maps() -> list[DepthMap]:
    return [result for _, result in compute_depth_of_scene()[0]]


def draw_dot(where: tuple[float, float], camera: Camera) -> np.ndarray:
    """Draw a soft white spot on black."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    spot = 250 * np.exp(-((u - where[0]) ** 2 + (v - where[1]) ** 2) / 8)
    return np.repeat(spot.astype(np.uint8)[..., None], 3, axis=2)


def compute_centroid(image: np.ndarray) -> np.ndarray:
    weight = image[..., 0].astype(float)
    v, u = np.mgrid[: weight.shape[0], : weight.shape[1]]
    return np.array([(u * weight).sum(), (v * weight).sum()]) / weight.sum()


@pytest.mark.parametrize("rolls", [(0, 0), (180, 180), (90, 90), (-90, -90), (37, 37), (0, 180), (90, 20)])
@pytest.mark.parametrize("angle", [9, -9])
def test_a_point_is_on_the_same_row_of_both_rectified_images(
    rolls: tuple[float, float], angle: float
) -> None:
    first, second = make_view(posed_scene.pose(2, rolls[0])), make_view(posed_scene.pose(2 + angle, rolls[1]))
    pair = rectify_views(first, second)
    assert pair is not None
    rig, near, far = pair
    assert rig.baseline == pytest.approx(np.linalg.norm(second.centre - first.centre))
    for point in np.array([(0, 0, -0.2), (0.1, -0.12, 0.1), (-0.15, 0.1, 0.25)]):
        images = []
        for one in (first, second):
            u, v, _ = one.project(point)
            assert one.contains(u, v)
            images.append(draw_dot((float(u), float(v)), one.camera))
        left, right = (compute_centroid(image) for image in rig.apply(*images))
        assert abs(left[1] - right[1]) < 0.1
        seen = rig.rectified_from_left @ first.world_from_camera[:3, :3].T @ (point - first.centre)
        assert near <= seen[2] <= far
        # z = f b / (d + offset), and the spot is where the rectified camera projects the point.
        depth = rig.focal_baseline / (left[0] - right[0] + rig.principal_offset)
        assert depth == pytest.approx(seen[2], rel=2e-3)
        expected = seen[:2] / seen[2] * rig.left.fx + (rig.left.cx, rig.left.cy)
        np.testing.assert_allclose(left, expected, atol=0.1)


def test_views_along_the_axis_or_without_baseline_are_not_a_pair() -> None:
    first = make_view(posed_scene.pose(0, 0))
    assert rectify_views(first, make_view(posed_scene.pose(0, 90))) is None
    assert rectify_views(first, make_view(posed_scene.pose(0, 0, distance=1.4))) is None


def test_depth_is_converted_to_the_axis_of_the_view() -> None:
    first, second = make_view(posed_scene.pose(-4, 30)), make_view(posed_scene.pose(4, 30))
    pair = rectify_views(first, second)
    assert pair is not None
    rig = pair[0]
    # The board, z = 0.25 in the world, in the axes of the rectified camera.
    u, v = np.meshgrid(np.arange(rig.left.width), np.arange(rig.left.height))
    rays = np.stack(
        [(u - rig.left.cx) / rig.left.fx, (v - rig.left.cy) / rig.left.fy, np.ones(u.shape)], axis=-1
    )
    way = rays @ rig.rectified_from_left @ first.world_from_camera[:3, :3].T
    rectified = ((0.25 - first.centre[2]) / way[..., 2]).astype(np.float32)
    trust = np.full(rectified.shape, 200, np.uint8)

    depth, confidence = transfer_depth(rectified, trust, rig, first, second)

    camera = posed_scene.CAMERA
    u, v = np.meshgrid(np.arange(camera.width, dtype=float), np.arange(camera.height, dtype=float))
    way = first.compute_rays(u, v) @ first.world_from_camera[:3, :3].T
    truth = (0.25 - first.centre[2]) / way[..., 2]
    inside = second.contains(*second.project(first.to_world(first.compute_rays(u, v) * truth[..., None]))[:2])
    assert inside.mean() > 0.7
    np.testing.assert_allclose(depth[inside], truth[inside], rtol=1e-5)
    assert not depth[~inside].any()
    np.testing.assert_array_equal(confidence, np.where(inside, 200, 0))


def test_depth_of_a_made_scene() -> None:
    scan, truth = posed_scene.make_posed_scan()

    results, told = compute_depth_of_scene()

    assert told[-1] == (21, 21)
    for (frame, result), given, true in zip(results, scan.frames, truth, strict=True):
        assert isinstance(result, DepthMap)
        assert frame.name == given.name
        np.testing.assert_array_equal(frame.world_from_camera, given.world_from_camera)
        assert frame.camera == posed_scene.CAMERA
        assert frame.depth is result.depth
        np.testing.assert_array_equal(result.color, given.color)
        used = result.depth > 0
        # A pixel of disparity between neighbours is 1.2 m / (300 px · 0.147 m), 2.7 % of depth.
        wrong = np.abs(result.depth - true)[used & (true > 0)] / true[used & (true > 0)]
        assert np.median(wrong) < 0.003
        assert np.mean(wrong > 0.02) < 0.02
        assert np.mean(used[true > 0]) > 0.55
        # The black background has no surface, except for a rim.
        assert not used[~binary_dilation(true > 0, iterations=3)].any()
        assert np.mean(used[true == 0]) < 0.05


def test_results_do_not_depend_on_threads() -> None:
    scan, _ = posed_scene.make_posed_scan()
    scan = replace(scan, frames=scan.frames[:4])
    one, two = (list(views_depth(scan, DepthParams(threads=n))) for n in (1, 2))
    for (_, first), (_, second) in zip(one, two, strict=True):
        np.testing.assert_array_equal(first.depth, second.depth)


def test_depth_outside_a_given_box_is_removed() -> None:
    scan, truth = posed_scene.make_posed_scan()
    ball = np.array([[-0.23, -0.23, -0.23], [0.23, 0.23, 0.0]])
    with collecting() as diagnostics:
        (_, result) = list(views_depth(replace(scan, bounding_box=ball)))[3]
    # Many visible surfaces are outside the box.
    assert [one.code for one in diagnostics] == [DEPTH_COVERAGE_LOW.name]
    at = np.array(scan.frames[3].world_from_camera)
    assert np.mean(result.depth[(truth[3] > 0) & (truth[3] < 1.15)] > 0) > 0.7
    rows, columns = np.nonzero(result.depth)
    one = make_view(at)
    points = one.to_world(
        one.compute_rays(columns.astype(float), rows.astype(float)) * result.depth[rows, columns, None]
    )
    margin = 0.02 * np.linalg.norm(ball[1] - ball[0])
    assert (points >= ball[0] - margin - 1e-6).all()
    assert (points <= ball[1] + margin + 1e-6).all()


def test_planted_wrong_depth_is_inconsistent() -> None:
    scan, truth = posed_scene.make_posed_scan()
    views = [make_view(np.array(frame.world_from_camera)) for frame in scan.frames]
    depth = truth[3].astype(np.float32)
    depth[80:100, 110:130] *= 0.95
    others = [(views[at], truth[at].astype(np.float32)) for at in (1, 2, 4, 5)]

    count = count_supporting_views(views[3], depth, others, 0.01, 0.02).consistent

    assert not count[80:100, 110:130].any()
    sound = truth[3] > 0
    sound[75:105, 105:135] = False
    assert np.mean(count[sound] >= 2) > 0.9
    assert not count[truth[3] == 0].any()


def test_merging_uses_the_majority_of_partners() -> None:
    depths = [np.full((1, 4), z, np.float32) for z in (1.0, 1.004, 2.0)]
    depths[0][0, 1] = depths[1][0, 1] = 0
    depths[0][0, 2] = depths[1][0, 2] = depths[2][0, 2] = 0
    depths[2][0, 3] = 1.008
    confidences = [np.full((1, 4), c, np.uint8) for c in (10, 20, 30)]

    depth, confidence = merge_depth_maps(depths, confidences, 0.01)

    np.testing.assert_allclose(depth, [[1.002, 2.0, 0, 1.004]], rtol=1e-6)
    np.testing.assert_array_equal(confidence, [[20, 30, 0, 30]])


def test_partners_have_a_moderate_baseline() -> None:
    views = make_ring(0, 0.3, 8, 20, 60, 180, -6)
    assert select_partners(views, 0, 2) == [2, 6]
    # Neither the view from the same position, nor views with too large angles or from behind.
    assert select_partners(views, 0, 9) == [2, 6, 3]
    assert score_partner(views[0], views[1]) == 0
    away = posed_scene.pose(8, 0)
    away[:3, :3] = away[:3, :3] @ np.diag((-1.0, 1.0, -1.0))
    assert score_partner(views[0], make_view(away)) == 0


def test_texture_is_distinguished_from_a_backdrop_and_its_rim() -> None:
    image = np.random.default_rng(1).normal(10, 1, (60, 80)).round().clip(0, 255).astype(np.uint8)
    image[:, :40] = np.random.default_rng(2).integers(50, 200, (60, 40))
    found = mask_textured_surroundings(image, 3.0)
    assert found[:, :38].all()
    assert not found[:, 42:].any()


def test_the_scene_is_at_the_intersection_of_optical_axes() -> None:
    views = [replace(v, near=0.0, far=np.inf) for v in make_ring(-20, 0, 30)]
    box = estimate_scene_box(views)
    assert box is not None
    # 1.2 m away, half of 240 px at a focal length of 300 px: 0.48 m around the origin.
    np.testing.assert_allclose(box, [[-0.48] * 3, [0.48] * 3], atol=1e-9)


def test_views_without_common_target_need_a_depth_range() -> None:
    scan, _ = posed_scene.make_posed_scan()
    shifted = []
    for number, frame in enumerate(scan.frames):
        pose = posed_scene.pose(0, 0)
        pose[0, 3] += 0.1 * number
        other = np.random.default_rng(number).integers(0, 255, (180, 240, 3), np.uint8)
        shifted.append(replace(frame, color=other, world_from_camera=pose))
    scan = replace(scan, frames=shifted)
    with pytest.raises(InputError, match=r"min_depth.*max_depth"):
        list(views_depth(scan))
    views = assign_depth_ranges(scan, create_posed_views(scan), [None] * 7, 0.5, 2.0)
    assert {(one.near, one.far) for one in views} == {(0.5, 2.0)}


def test_masked_pixels_have_no_depth() -> None:
    scan, _ = posed_scene.make_posed_scan()
    mask = np.full((180, 240), 255, np.uint8)
    mask[:, 130:] = 0
    frames = list(scan.frames)
    # The image of the third view is upside down, and so is its mask.
    frames[2] = upside_down(replace(frames[2], mask=mask))
    frames[3] = replace(frames[3], mask=mask)
    sound = [result.depth > 0 for result in get_depth_maps()]
    with collecting() as diagnostics:
        found = [result.depth > 0 for _, result in views_depth(replace(scan, frames=frames))]
    assert [one.code for one in diagnostics] == [DEPTH_IMAGES_TURNED.name]
    for at in (2, 3):
        assert not found[at][:, 130:].any()
        # A few pixels lose the agreement with masked pixels of other views, so they are less certain.
        assert np.mean(found[at][:, :130] & ~sound[at][:, :130]) < 0.002
        assert np.mean(found[at][:, :130] != sound[at][:, :130]) < 0.01


def test_feature_matches_give_the_distance_of_the_scene() -> None:
    """Two views 7° apart: the ball is about 1 m away, the board 1.45 m."""
    scan, truth = posed_scene.make_posed_scan()
    views = create_posed_views(scan)
    assert (0, 1) in find_overlapping_pairs(views)
    points = [detect_keypoints(frame.color[:, :, 0], 1000) for frame in scan.frames[:2]]

    found = match_views(views[0], views[1], *points)

    assert found.epipolar_error < 0.5
    same = match_descriptors(points[0].descriptors, points[1].descriptors)
    for side, depth in enumerate(found.depths):
        columns, rows = np.rint(points[side].pixels[same[:, side]]).astype(int).T
        true = truth[side][rows, columns]
        assert len(depth) > 50
        np.testing.assert_allclose(
            np.percentile(depth, (5, 50, 95)), np.percentile(true[true > 0], (5, 50, 95)), rtol=0.03
        )
    # From 30 cm below, the same points would be at other pixels.
    away = np.array(scan.frames[1].world_from_camera)
    away[1, 3] += 0.3
    assert match_views(views[0], replace(views[1], world_from_camera=away), *points) is None


def test_inexact_poses_are_refined() -> None:
    scan, truths = posed_scene.make_posed_scan()
    # Correct poses give no diagnostics; an uncollected diagnostic would raise an error.
    assert get_depth_maps()
    random = np.random.default_rng(6)
    frames = []
    for frame in scan.frames:
        pose = np.array(frame.world_from_camera)
        pose[:3, :3] @= Rotation.from_rotvec(random.normal(0, 0.25, 3), degrees=True).as_matrix()
        frames.append(replace(frame, world_from_camera=pose))
    used, errors = [], []
    with collecting() as diagnostics:
        found = list(views_depth(replace(scan, frames=frames)))
    assert DEPTH_POSES_MOVED.name in [one.code for one in diagnostics]
    assert any("the poses were refined from feature matches" in str(one) for one in diagnostics)
    for (frame, result), given, sound, true in zip(found, frames, get_depth_maps(), truths, strict=True):
        assert isinstance(result, DepthMap)
        assert not np.array_equal(frame.world_from_camera, given.world_from_camera)
        both = (result.depth > 0) & (true > 0)
        used.append(np.count_nonzero(both) / np.count_nonzero(sound.depth))
        errors.append(np.median(np.abs(result.depth - true)[both] / true[both]))
    # With the given poses the values are 0.57 and 0.017.
    assert np.mean(used) > 0.75
    assert np.median(errors) < 0.01


def ripple_columns(image: np.ndarray, phase: float) -> np.ndarray:
    """Shift image columns up and down by 5 px, like a poor lens or scanner."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]].astype(np.float32)
    return cv2.remap(image, u, np.float32(v + 5 * np.sin(u / 6 + phase)), cv2.INTER_LINEAR)


def test_poses_inconsistent_with_the_images_are_reported() -> None:
    scan, _ = posed_scene.make_posed_scan()
    frames = [replace(frame, color=ripple_columns(frame.color, k)) for k, frame in enumerate(scan.frames)]
    wrong = replace(scan, frames=frames)
    with pytest.raises(
        InputError, match=r"do not fit the images\. Set scan\.poses.*depth\.max_pose_error, 1\.1 px"
    ):
        list(views_depth(wrong, DepthParams(max_pose_error=1.1)))
    with collecting() as diagnostics:
        list(views_depth(wrong, DepthParams(max_skipped_ratio=1, max_pose_error=10)))
    # A second diagnostic reports low depth coverage.
    assert [one.code for one in diagnostics] == [POSE_INCONSISTENT_WITH_IMAGES.name, DEPTH_COVERAGE_LOW.name]
    assert "poses or calibration are inaccurate" in str(diagnostics[0])
    assert "depth covers only" in str(diagnostics[1])


def test_forward_motion_gives_depth_off_axis() -> None:
    frames, truths = [], []
    for number in range(4):
        where = posed_scene.pose(0, 0, distance=1.6 - 0.15 * number)
        image, true = posed_scene.render_view(where)
        frames.append(Frame(f"{number:04d}", posed_scene.CAMERA, color=image, world_from_camera=where))
        truths.append(true)
    for (_, result), true in zip(views_depth(Scan("made", frames)), truths, strict=True):
        assert isinstance(result, DepthMap)
        used = (result.depth > 0) & (true > 0)
        assert np.mean(used) > 0.15
        assert np.median(np.abs(result.depth - true)[used] / true[used]) < 0.008
    # These pairs cannot be rectified.
    with pytest.raises(InputError, match=r"angle of 1 to 35 degrees; .* in front of it or behind it"):
        list(views_depth(Scan("made", frames), views="pairs"))


def test_parallel_views_need_no_depth_range() -> None:
    """Cameras in a row with parallel axes: only feature matches give the distance of objects."""
    frames, truths = [], []
    for number in range(5):
        where = posed_scene.pose(0, 0)
        where[0, 3] += 0.08 * (number - 2)
        image, true = posed_scene.render_view(where)
        frames.append(Frame(str(number), posed_scene.CAMERA, color=image, world_from_camera=where))
        truths.append(true)
    for (_, result), true in zip(views_depth(Scan("made", frames)), truths, strict=True):
        assert isinstance(result, DepthMap)
        used = (result.depth > 0) & (true > 0)
        assert np.mean(used) > 0.3
        assert np.median(np.abs(result.depth - true)[used] / true[used]) < 0.002


def test_large_images_are_reduced(tmp_path) -> None:
    """A scene rendered at double size is measured at half resolution."""
    large = Camera(480, 360, 600.0, 610.0, 242.5, 174.5)
    frames, truths = [], []
    for number in range(4):
        where = posed_scene.pose(7.0 * number, 0)
        image, _ = posed_scene.render_view(where, large)
        cv2.imwrite(str(tmp_path / f"{number}.png"), image)
        frames.append(Frame(str(number), large, color=tmp_path / f"{number}.png", world_from_camera=where))
        truths.append(posed_scene.render_view(where)[1])
    with collecting() as diagnostics:
        results = list(views_depth(Scan("made", frames), DepthParams(max_side=240)))
    assert any("4 images were downscaled to 240 px" in str(one) for one in diagnostics)
    for (frame, result), true in zip(results, truths, strict=True):
        assert frame.camera == posed_scene.CAMERA
        used = (result.depth > 0) & (true > 0)
        assert np.mean(used) > 0.3
        assert np.median(np.abs(result.depth - true)[used] / true[used]) < 0.002


def test_damaged_images_are_skipped_up_to_a_share(tmp_path) -> None:
    scan, _ = posed_scene.make_posed_scan()
    broken = tmp_path / "broken.png"
    broken.write_bytes(b"\x89PNG")
    frames = list(scan.frames)
    frames[0] = replace(frames[0], color=broken)
    frames[1] = replace(frames[1], color=np.zeros((90, 120, 3), np.uint8))
    results = [result for _, result in views_depth(replace(scan, frames=frames))]
    assert [isinstance(result, SkippedFrame) for result in results] == [True, True] + [False] * 5
    assert "broken.png" in results[0].reason
    assert "120×90" in results[1].reason
    with pytest.raises(InputError, match=r"max_skipped allows a ratio of 0\.1"):
        list(views_depth(replace(scan, frames=frames), DepthParams(max_skipped_ratio=0.1)))


def test_a_single_view_has_no_depth() -> None:
    scan, _ = posed_scene.make_posed_scan()
    with pytest.raises(InputError, match=r"a single view has no depth: .* in 3 views"):
        list(views_depth(replace(scan, frames=scan.frames[:1])))
    with pytest.raises(InputError, match=r"2 views are too few: .*depth\.min_consistent_views"):
        list(views_depth(replace(scan, frames=scan.frames[:2])))
    two = [
        result
        for _, result in views_depth(
            replace(scan, frames=scan.frames[:2]), DepthParams(min_consistent_views=1)
        )
    ]
    assert all(isinstance(result, DepthMap) for result in two)


def test_views_without_poses_or_images_are_reported() -> None:
    scan, _ = posed_scene.make_posed_scan()
    frames = [replace(scan.frames[0], world_from_camera=None), *scan.frames[1:]]
    with pytest.raises(InputError, match="0000 has no pose"):
        list(views_depth(replace(scan, frames=frames)))
    frames = [replace(frame, color=None) for frame in scan.frames]
    with pytest.raises(InputError, match="0003: the image is missing"):
        list(views_depth(replace(scan, frames=frames)))


def upside_down(frame: Frame) -> Frame:
    mask = None if frame.mask is None else np.ascontiguousarray(frame.mask[::-1, ::-1])
    return replace(frame, color=np.ascontiguousarray(frame.color[::-1, ::-1]), mask=mask)


@pytest.mark.parametrize("places", [[], [5], [0, 1, 2, 3], [1, 3, 6]])
def test_upside_down_images_are_rotated(
    places: list[int],
) -> None:
    (scan, _), expected = posed_scene.make_posed_scan(), get_depth_maps()
    frames = [upside_down(frame) if at in places else frame for at, frame in enumerate(scan.frames)]

    # Without rotated images the expected results are reused; only the absence of diagnostics is checked.
    results = expected
    with collecting() as diagnostics:
        if places:
            results = [result for _, result in views_depth(replace(scan, frames=frames))]

    said = f"{len(places)} images are upside down"
    assert [said in str(one) for one in diagnostics] == [True] * bool(places)
    for result, sound in zip(results, expected, strict=True):
        np.testing.assert_array_equal(result.color, sound.color)
        np.testing.assert_array_equal(result.depth, sound.depth)


def test_rotating_images_can_be_disabled() -> None:
    scan, _ = posed_scene.make_posed_scan()
    frames = [*scan.frames[:6], upside_down(scan.frames[6])]
    with collecting() as diagnostics:
        *_, (_, result) = views_depth(replace(scan, frames=frames), DepthParams(fix_upside_down=False))
    assert isinstance(result, SkippedFrame) or np.mean(result.depth > 0) < 0.05
    assert not diagnostics


def test_a_part_of_temple_ring(shared_data) -> None:
    """Views from the front and the back; in this copy of the data those from the back are upside down."""
    scan = read_scan(shared_data / "stereo" / "middlebury_templeRing")
    wanted = [f"templeR{number:04d}" for number in (12, 13, 14, 15, 42, 43, 44)]
    frames = [frame for frame in scan.frames if frame.name in wanted]
    with collecting() as diagnostics:
        measured = list(views_depth(replace(scan, frames=frames)))
    results = {frame.name: (frame, result) for frame, result in measured}
    assert any("3 images are upside down" in str(one) for one in diagnostics)
    clouds = {}
    for name in ("templeR0013", "templeR0014", "templeR0043"):
        frame, result = results[name]
        assert np.mean(result.depth > 0) > 0.15
        rows, columns = np.nonzero(result.depth)
        one = PosedView(frame.camera, frame.world_from_camera, 0.4, 0.7)
        rays = one.compute_rays(columns.astype(float), rows.astype(float))
        clouds[name] = one.to_world(rays * result.depth[rows, columns, None])
        # The backdrop is black, the temple is not.
        assert np.mean(result.color[result.depth > 0].max(axis=1) > 40) > 0.97
    tree = cKDTree(clouds["templeR0013"])
    # The temple is 16 cm high; depth from other pairs of views agrees.
    assert np.median(tree.query(clouds["templeR0014"])[0]) < 0.0005
    assert np.median(tree.query(clouds["templeR0043"])[0]) < 0.001


@pytest.mark.parametrize("size", [(1, 1), (4, 3), (16, 16)])
def test_tiny_images_are_refused(size: tuple[int, int]) -> None:
    scan, _ = posed_scene.make_posed_scan()
    width, height = size
    camera = Camera(width, height, 1.2 * max(size), 1.2 * max(size), width / 2, height / 2)
    frames = [
        replace(frame, camera=camera, color=np.ascontiguousarray(frame.color[:height, :width]))
        for frame in scan.frames
    ]
    with pytest.raises(InputError, match="views cannot be used"):
        list(views_depth(replace(scan, frames=frames)))


def test_a_pose_far_away_is_reported() -> None:
    scan, _ = posed_scene.make_posed_scan()
    far = scan.frames[2].world_from_camera.copy()
    far[0, 3] = 1e200
    frames = [*scan.frames[:2], replace(scan.frames[2], world_from_camera=far)]
    with pytest.raises(InputError, match="0002 is wrong"):
        list(views_depth(replace(scan, frames=frames)))


def test_colour_images_of_a_room_give_its_depth() -> None:
    """RGB-D frames of the sample without depth: a moving camera whose optical axes do not intersect."""
    scan = read_scan(Path(__file__).resolve().parents[3] / "samples" / "rgbd")
    frames = [replace(frame, depth=None) for frame in scan.frames[8:16]]

    with collecting() as diagnostics:
        results = list(views_depth(replace(scan, frames=frames), DepthParams(partners=2)))

    assert not diagnostics
    wrong, covered = [], []
    for (_, result), frame in zip(results, scan.frames[8:16], strict=True):
        assert isinstance(result, DepthMap)
        truth = read_depth(frame)
        both = (truth > 0) & (result.depth > 0)
        wrong.append(np.abs(result.depth - truth)[both] / truth[both])
        covered.append(np.mean(result.depth[truth > 0] > 0))
    assert np.median(np.concatenate(wrong)) < 0.006
    assert np.mean(np.concatenate(wrong) > 0.05) < 0.02
    assert np.mean(covered) > 0.5
