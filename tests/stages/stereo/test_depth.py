"""Depth of rendered pairs with known disparity and depth."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from scanloom import stages
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, SkippedFrame, StereoRig
from scanloom.stages.stereo.codes import DEPTH_PAIR_ROWS_DIFFER
from scanloom.stages.stereo.depth import DepthMap, DepthParams, depth, depth_scan

WIDTH, HEIGHT = 320, 240
CAMERA = Camera(WIDTH, HEIGHT, 300.0, 300.0, 159.5, 119.5)


def make_baseline(metres: float) -> np.ndarray:
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -metres
    return right_from_left


RIG = StereoRig(CAMERA, CAMERA, make_baseline(0.1), is_rectified=True)


@cache
def make_noise() -> np.ndarray:
    """Make fixed random grey levels, smooth over about two pixels, with a period of 512."""
    raw = np.random.default_rng(3).uniform(20, 235, (512, 512)).astype(np.float32)
    smooth = gaussian_filter(raw, 1.0, mode="wrap")
    return np.clip((smooth - 127) * 3 + 127, 0, 255)


def sample_noise(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Sample the noise at real coordinates."""
    u, v = (np.mod(x, 512).astype(np.float32) for x in (u, v))
    return cv2.remap(make_noise(), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)


def make_pixel_grid() -> tuple[np.ndarray, np.ndarray]:
    u, v = np.meshgrid(np.arange(WIDTH, dtype=np.float64), np.arange(HEIGHT, dtype=np.float64))
    return u, v


def render_slanted_pair(
    at_corner: float, per_column: float, per_row: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render left and right grey images of a plane; return the left disparity, linear in pixels."""
    u, v = make_pixel_grid()
    left_u = (u + at_corner + per_row * v) / (1 - per_column)
    images = [sample_noise(u, v), sample_noise(left_u, v)]
    truth = at_corner + per_column * u + per_row * v
    return images[0].astype(np.uint8), images[1].astype(np.uint8), truth


def measure_errors(result: DepthMap, truth: np.ndarray) -> np.ndarray:
    return np.abs(result.disparity - truth)[result.depth > 0]


@pytest.mark.parametrize("matcher", ["3way", "hh4", "sgbm", "hh"])
def test_the_disparity_of_a_slanted_plane_has_subpixel_accuracy(matcher: str) -> None:
    left, right, truth = render_slanted_pair(8, 0.05, 0.03)

    result = depth(left, right, RIG, matcher=matcher, disparities=64)

    wrong = measure_errors(result, truth)
    assert np.median(wrong) < 0.15
    assert np.mean(wrong > 1) < 0.002
    # Pixels that leave the right image on the left cannot be matched; nearly all others are.
    seen = (np.arange(WIDTH) - truth) >= 0
    assert np.mean(result.depth[seen] > 0) > 0.97


def test_the_left_border_is_covered_as_far_as_visible_in_the_right_image() -> None:
    left, right, truth = render_slanted_pair(12, 0, 0)

    result = depth(left, right, RIG, disparities=128)

    strip = result.depth[:, 16:128]
    assert np.mean(strip > 0) > 0.97
    assert np.median(np.abs(result.disparity - truth)[:, 16:128]) < 0.1


def test_depth_includes_the_principal_point_offset() -> None:
    left, right, _ = render_slanted_pair(10, 0, 0)
    rig = replace(RIG, right=replace(CAMERA, cx=CAMERA.cx + 5))

    result = depth(left, right, rig, disparities=32)

    assert np.median(result.depth[result.depth > 0]) == pytest.approx(300 * 0.1 / (10 + 5), rel=0.01)
    assert result.search.lowest == -5


@pytest.mark.parametrize(
    ("given", "wrong", "in_hidden"),
    [
        ({"matcher": "3way", "sgbm": {"left_right": "project"}}, 0.002, 0.05),
        ({"matcher": "3way", "sgbm": {"left_right": "match"}}, 0.002, 0.05),
        # Pixels occluded in the right image are filled from their surroundings, of which four fifths are
        # wall.
        ({"matcher": "census"}, 0.003, None),
    ],
)
def test_foreground_depth_does_not_bleed_into_the_background(
    given: dict[str, Any], wrong: float, in_hidden: float | None
) -> None:
    """A square in front of a wall: next to it are pixels that the right camera cannot see."""
    u, v = make_pixel_grid()
    near = (np.abs(u - 180) < 50) & (np.abs(v - 120) < 50)
    near_right = (np.abs(u + 30 - 180) < 50) & (np.abs(v - 120) < 50)
    left = np.where(near, sample_noise(u + 200, v + 90), sample_noise(u, v)).astype(np.uint8)
    right = np.where(near_right, sample_noise(u + 30 + 200, v + 90), sample_noise(u + 12, v)).astype(np.uint8)
    truth = np.where(near, 30, 12)

    result = depth(left, right, RIG, disparities=48, **given)

    used = result.depth > 0
    hidden = ~near & near_right[:, np.maximum(np.arange(WIDTH) - 12, 0)]
    assert np.mean(measure_errors(result, truth) > 2) < wrong
    if in_hidden is None:
        assert np.mean(np.abs(result.disparity - truth)[hidden & used] < 2) > 0.8
    else:
        assert used[hidden].mean() < in_hidden
    assert used[~hidden & (u > 16)].mean() > 0.9


def test_confidence_orders_pixels_by_error_rate() -> None:
    left, right, truth = render_slanted_pair(6, 0.04, 0.05)
    rng = np.random.default_rng(1)
    # Sensor noise that increases from top to bottom until it dominates the texture.
    noise = np.linspace(0, 120, HEIGHT)[:, None]
    left, right = (
        np.clip(i + rng.normal(0, 1, i.shape) * noise, 0, 255).astype(np.uint8) for i in (left, right)
    )

    result = depth(left, right, RIG, disparities=48, min_confidence=0)

    wrong = np.abs(result.disparity - truth) > 1
    shares = [
        wrong[(result.confidence >= low) & (result.confidence < high)].mean()
        for low, high in ((1, 80), (80, 160), (160, 256))
    ]
    assert shares[0] > 2 * shares[1] > 4 * shares[2]
    assert (result.confidence[~np.isfinite(result.disparity)] == 0).all()


def test_a_lower_confidence_bound_gives_more_depth() -> None:
    left, right, _ = render_slanted_pair(8, 0.05, 0.03)

    strict, lax = (depth(left, right, RIG, disparities=64, min_confidence=c) for c in (250, 1))

    assert (strict.depth[strict.confidence < 250] == 0).all()
    assert (lax.depth[lax.confidence == 0] == 0).all()
    assert 0 < np.count_nonzero(strict.depth) < np.count_nonzero(lax.depth)


def test_single_pairs_have_a_stricter_confidence_bound() -> None:
    left, right, _ = render_slanted_pair(8, 0.05, 0.03)
    frame = Frame("0", CAMERA, color=left, right=right)

    def given(pairs: int, **changes: Any) -> np.ndarray:
        scan = Scan("made", [frame] * pairs, RIG)
        (_, first), *_ = depth_scan(scan, matcher="3way", disparities=64, **changes)
        assert isinstance(first, DepthMap)
        return first.depth

    alone = depth(left, right, RIG, matcher="3way", disparities=64).depth
    assert np.array_equal(given(1), alone)
    assert np.array_equal(given(2), alone)
    assert np.count_nonzero(given(3)) > np.count_nonzero(alone)
    assert np.array_equal(given(3, min_confidence=128, sgbm={"uniqueness": 20}), alone)


def test_one_or_two_pairs_use_the_census_matcher() -> None:
    left, right, _ = render_slanted_pair(8, 0.05, 0.03)
    frame = Frame("0", CAMERA, color=left, right=right)

    def given(pairs: int, **changes: Any) -> np.ndarray:
        (_, first), *_ = depth_scan(Scan("made", [frame] * pairs, RIG), disparities=64, **changes)
        return first.disparity

    def same(a: np.ndarray, b: np.ndarray) -> bool:
        return np.array_equal(a, b, equal_nan=True)

    for pairs in (1, 2):
        assert same(given(pairs), given(pairs, matcher="census"))
        # An option of the other matchers selects them.
        assert same(given(pairs, sgbm={"p1": 100}), given(pairs, matcher="3way", sgbm={"p1": 100}))
    assert same(given(3), given(3, matcher="3way"))
    # 8,000 × 6,000 px and 100 disparities take 28 GB.
    assert stages.DepthParams().uses_census(1, 4 << 30)
    assert not stages.DepthParams().uses_census(1, 28 << 30)
    assert stages.DepthParams(matcher="census").uses_census(9, 28 << 30)


def test_the_depth_range_ends_at_the_expected_error_limit() -> None:
    left, right, truth = render_slanted_pair(4, 0.1, 0)

    result = depth(left, right, RIG, disparities=64, disparity_sigma=0.2, max_relative_depth_error=0.02)

    # σ_z / z = z / (f·b) · σ_d = σ_d / d: 2 % at d = 10 px, which is 3 m.
    assert result.max_depth == pytest.approx(3.0)
    assert (result.depth[truth < 9.5] == 0).all()
    assert np.mean(result.depth[:, 100:][truth[:, 100:] > 10.5] > 0) > 0.9


def test_the_depth_range_determines_the_disparity_search() -> None:
    left, right, _ = render_slanted_pair(20, 0, 0)

    result = depth(left, right, RIG, min_depth=1.0, max_depth=2.0)

    # f·b = 30: 15 to 30 px.
    assert (result.search.lowest, result.search.count) == (15, 16)
    assert result.to_dict()["min_depth_m"] == 1.0
    assert result.to_dict()["max_depth_m"] == 2.0
    assert np.median(result.depth[result.depth > 0]) == pytest.approx(1.5, rel=0.01)


def test_the_disparity_range_is_estimated_from_the_pair() -> None:
    left, right, truth = render_slanted_pair(20, 0.02, 0)

    result = depth(left, right, RIG)

    assert truth.max() < result.search.end < 60
    assert np.mean(measure_errors(result, truth) > 1) < 0.002
    stated = depth(left, right, replace(RIG, disparity_count=70))
    assert (stated.search.lowest, stated.search.count) == (0, 80)


def test_smoothing_fills_disparity_but_not_depth() -> None:
    left, right, truth = render_slanted_pair(14, 0.05, 0.03)
    left[100:140, 150:200] = 90
    right[100:140, 120:190] = 90

    plain, smooth = (
        depth(left, right, RIG, matcher="3way", disparities=48, sgbm={"smooth": on}) for on in (False, True)
    )

    assert np.isfinite(smooth.disparity).sum() > np.isfinite(plain.disparity).sum()
    assert np.array_equal(smooth.confidence, plain.confidence)
    assert not (smooth.depth > 0)[plain.depth == 0].any()
    assert np.nanmax(np.abs(smooth.disparity - truth)[110:130, 160:190]) < 6


def test_grey_and_colour_give_the_same_depth() -> None:
    left, right, _ = render_slanted_pair(8, 0.05, 0)

    grey = depth(left, right, RIG)
    color = depth(np.dstack([left] * 3), np.dstack([right] * 3), RIG)

    assert np.array_equal(grey.depth, color.depth)
    assert grey.color.shape == color.color.shape == (HEIGHT, WIDTH, 3)


def test_a_very_wide_pair_stays_within_the_fixed_point() -> None:
    """A quarter of the width is more than int16 can represent in sixteenths."""
    camera = Camera(12000, 32, 9000.0, 9000.0, 5999.5, 15.5)
    image = np.random.default_rng(5).integers(0, 255, (32, 12000), np.uint8)

    result = depth(image, np.roll(image, -40, axis=1), StereoRig(camera, camera, make_baseline(0.1), True))

    assert np.median(result.disparity[result.depth > 0]) == pytest.approx(40, abs=0.1)


def test_blank_pair_has_no_depth() -> None:
    blank = np.full((HEIGHT, WIDTH), 255, np.uint8)

    result = depth(blank, blank, RIG)

    assert not result.depth.any()
    assert not result.confidence.any()
    assert result.to_dict()["median_depth_m"] is None


# Unrectified rigs -------------------------------------------------------------------------------------

WORLD_PLANE = (np.array([0.15, -0.1, -1.0]) / np.linalg.norm([0.15, -0.1, -1.0]), -1.8)


def render_plane(camera: Camera, world_from_camera: np.ndarray) -> np.ndarray:
    """Render a textured plane for a camera with distortion, ray by ray."""
    u, v = make_pixel_grid()
    seen = np.stack([(u.ravel() - camera.cx) / camera.fx, (v.ravel() - camera.cy) / camera.fy])
    k1, k2, p1, p2 = camera.distortion
    ideal = seen
    for _ in range(50):  # The lens model maps ideal to distorted positions; its inverse is a fixed point.
        x, y = ideal
        r2 = x * x + y * y
        tangential = np.stack(
            [2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y]
        )
        ideal = (seen - tangential) / (1 + k1 * r2 + k2 * r2 * r2)
    rays = np.column_stack([ideal.T, np.ones(ideal.shape[1])]) @ world_from_camera[:3, :3].T
    origin = world_from_camera[:3, 3]
    normal, offset = WORLD_PLANE
    hit = origin + rays * ((offset - normal @ origin) / (rays @ normal))[:, None]
    x, y = (hit[:, axis].reshape(HEIGHT, WIDTH) for axis in (0, 1))
    return sample_noise(x * 150, y * 150).astype(np.uint8)


@pytest.fixture(scope="module")
def unrectified() -> Scan:
    left = Camera(WIDTH, HEIGHT, 300.0, 302.0, 155.0, 122.0, (-0.25, 0.07, 0.0005, -0.0003))
    right = Camera(WIDTH, HEIGHT, 305.0, 304.0, 163.0, 117.0, (-0.24, 0.06, -0.0004, 0.0002))
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = cv2.Rodrigues(np.array([0.02, -0.03, 0.015]))[0]
    right_from_left[:3, 3] = [-0.12, 0.004, -0.006]
    frames = []
    for number in range(3):
        world_from_left = np.eye(4)
        world_from_left[:3, :3] = cv2.Rodrigues(np.array([0.02, 0.05 * number, 0.1]))[0]
        world_from_left[:3, 3] = [0.05 * number, 0.02, 0.1 * number]
        frames.append(
            Frame(
                f"{number}",
                left,
                color=np.dstack([render_plane(left, world_from_left)] * 3),
                right=np.dstack([render_plane(right, world_from_left @ np.linalg.inv(right_from_left))] * 3),
                world_from_camera=world_from_left,
            )
        )
    return Scan("made", frames, StereoRig(left, right, right_from_left, is_rectified=False))


def test_rectified_depth_and_pose_reproduce_the_plane(unrectified: Scan) -> None:
    normal, offset = WORLD_PLANE
    for frame, result in depth_scan(unrectified):
        assert isinstance(result, DepthMap)
        assert result.diagnostics == ()
        assert frame.right is None
        assert frame.camera.distortion == ()
        z = result.depth
        assert np.mean(z > 0) > 0.8
        u, v = make_pixel_grid()
        camera = frame.camera
        points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z])[:, z > 0]
        assert frame.world_from_camera is not None
        world = frame.world_from_camera[:3, :3] @ points + frame.world_from_camera[:3, 3:]
        off = normal @ world - offset
        # A pixel of disparity is 7 cm here: no visible bias, and a noise of a seventh of a pixel.
        assert abs(np.median(off)) < 0.004
        assert np.median(np.abs(off)) < 0.015
        assert np.mean(np.abs(off) > 0.08) < 0.01


def test_results_do_not_depend_on_the_number_of_threads(unrectified: Scan) -> None:
    one, many = (list(depth_scan(unrectified, threads=n)) for n in (1, 4))

    for (a, first), (b, second) in zip(one, many, strict=True):
        assert a.name == b.name
        assert isinstance(first, DepthMap)
        assert isinstance(second, DepthMap)
        assert np.array_equal(first.depth, second.depth)
        assert np.array_equal(first.confidence, second.confidence)


def test_a_rig_wrongly_marked_as_rectified_gives_a_warning() -> None:
    left, right, _ = render_slanted_pair(12, 0, 0)

    result = depth(left, np.roll(right, 3, axis=0), RIG)

    (diagnostic,) = result.diagnostics
    assert diagnostic.code == DEPTH_PAIR_ROWS_DIFFER.name
    assert "rows of the pair differ by 3.0 px" in str(diagnostic)


# Invalid input ----------------------------------------------------------------------------------------


def test_swapped_images_are_refused() -> None:
    left, right, _ = render_slanted_pair(12, 0.02, 0)

    with pytest.raises(InputError, match="seem swapped"):
        depth(right, left, RIG)


@pytest.mark.parametrize(
    ("rig", "message"),
    [
        (replace(RIG, right_from_left=make_baseline(-0.1)), "right camera is left of the left"),
        (replace(RIG, right_from_left=np.eye(4)), "give the baseline"),
        (replace(RIG, right=replace(CAMERA, cy=130.0)), "marked as rectified, but cy"),
        (replace(RIG, right=replace(CAMERA, width=640)), "both must have the same size"),
        (
            replace(RIG, left=replace(CAMERA, distortion=(0.1,) * 3), is_rectified=False),
            "3 distortion coefficients",
        ),
    ],
)
def test_invalid_rigs_are_refused(rig: StereoRig, message: str) -> None:
    left, right, _ = render_slanted_pair(8, 0, 0)

    with pytest.raises(InputError, match=message):
        depth(left, right, rig)


def test_vertically_arranged_cameras_are_refused() -> None:
    left, right, _ = render_slanted_pair(8, 0, 0)
    above = np.eye(4)
    above[1, 3] = -0.1

    with pytest.raises(InputError, match="one above the other"):
        depth(left, right, StereoRig(CAMERA, CAMERA, above, is_rectified=False))


@pytest.mark.parametrize(
    ("left", "right", "message"),
    [
        (
            np.zeros((HEIGHT, WIDTH), np.uint8),
            np.zeros((HEIGHT, WIDTH - 1), np.uint8),
            "right image is 319×240",
        ),
        (np.zeros((100, 100), np.uint8), np.zeros((100, 100), np.uint8), "calibrated for 320×240"),
        (np.zeros((HEIGHT, WIDTH), np.uint16), np.zeros((HEIGHT, WIDTH), np.uint16), "uint16"),
        (
            np.zeros((HEIGHT, WIDTH, 4), np.uint8),
            np.zeros((HEIGHT, WIDTH, 4), np.uint8),
            "left image must be",
        ),
    ],
)
def test_inconsistent_images_are_refused(left: Any, right: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        depth(left, right, RIG)


def test_one_bad_frame_is_skipped_with_its_reason(tmp_path: Path) -> None:
    left, right, _ = render_slanted_pair(8, 0.05, 0)
    frames = []
    for number in range(4):
        files = tmp_path / f"left{number}.png", tmp_path / f"right{number}.png"
        for file, image in zip(files, (left, right), strict=True):
            cv2.imwrite(str(file), image)
        frames.append(Frame(f"{number}", CAMERA, color=files[0], right=files[1]))
    cv2.imwrite(str(tmp_path / "right0.png"), right[:, :-8])
    seen: list[tuple[int, int]] = []

    results = list(depth_scan(Scan("made", frames, RIG, tmp_path), progress=lambda *at: seen.append(at)))

    assert [frame.name for frame, _ in results] == ["0", "1", "2", "3"]
    skipped = results[0][1]
    assert isinstance(skipped, SkippedFrame)
    assert "right0.png" in skipped.reason
    assert "left0.png" in skipped.reason
    assert all(isinstance(result, DepthMap) for _, result in results[1:])
    assert seen == [(1, 4), (2, 4), (3, 4), (4, 4)]


def test_a_scan_of_mostly_bad_frames_is_refused(tmp_path: Path) -> None:
    left, right, _ = render_slanted_pair(8, 0.05, 0)
    good = Frame("good", CAMERA, color=left, right=right)
    missing = Frame("gone", CAMERA, color=tmp_path / "gone.png", right=right)

    with pytest.raises(InputError, match=r"2 of the scan's 3 pairs cannot be used.*gone\.png"):
        list(depth_scan(Scan("made", [good, missing, missing], RIG, tmp_path)))


def test_swapped_folders_are_refused_at_the_first_pair(tmp_path: Path) -> None:
    left, right, _ = render_slanted_pair(12, 0.02, 0)

    with pytest.raises(InputError, match=f"{tmp_path.name}.*seem swapped"):
        next(depth_scan(Scan("made", [Frame("0", CAMERA, color=right, right=left)] * 3, RIG, tmp_path)))


def test_rgbd_scan_has_no_pairs() -> None:
    with pytest.raises(InputError, match="no stereo pairs"):
        next(depth_scan(Scan("made", [])))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sgbm": {"block_size": 4}}, "must be odd"),
        ({"min_depth": 2.0, "max_depth": 1.0}, "max_depth"),
        ({"sgbm": {"p1": 500}}, "sgbm.p1"),
        ({"matcher": "magic"}, "3way"),
        ({"min_confidence": 256}, "at most 255"),
        ({"wrong": 1}, "unknown parameter"),
        ({"max_depth": 0.05}, "max_depth is 0.05 m"),
    ],
)
def test_wrong_parameters_are_refused(changes: dict[str, Any], message: str) -> None:
    left, right, _ = render_slanted_pair(8, 0, 0)

    with pytest.raises(UsageError, match=message):
        depth(left, right, RIG, **changes)


def test_parameters_are_declared_with_text() -> None:
    from scanloom.stages.params import describe_all

    assert all(about.text for about in describe_all(DepthParams).values())
    assert not describe_all(DepthParams)["threads"].invalidates
