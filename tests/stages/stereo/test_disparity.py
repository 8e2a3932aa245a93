"""The semi-global matcher: comparison with a reference implementation, synthetic and real pairs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import Camera, InputError, StereoRig, UsageError, depth, stages, stereo_disparity
from scanloom.stages import _kernels as kernels
from tests.stages.stereo.test_depth_real import mask_visible

SMALL, LARGE, EDGE = 24, 300.0, 30.0


def read_rgb(path: Path) -> np.ndarray:
    image = cv2.imread(str(path))
    assert image is not None
    return image[..., ::-1].copy()


def make_pattern(height: int, width: int, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(0, 256, (height // 3 + 1, width // 3 + 1, 3), np.uint8)
    return cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)


def make_shifted_pair(disparity: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Make a right image of noise, and the left image for given disparities."""
    height, width = disparity.shape
    right = make_pattern(height, width, seed)
    columns = np.arange(width, dtype=np.float32) - disparity.astype(np.float32)
    rows = np.repeat(np.arange(height, dtype=np.float32)[:, None], width, axis=1)
    left = cv2.remap(right, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return left, right


def match_pair(left: np.ndarray, right: np.ndarray, threads: int = 1, **search: int) -> Any:
    return kernels.match_pair(left, right, wanted_threads=threads, **{"lowest": 0, "count": 16} | search)


# Reference implementation of the kernel in integers, pixel by pixel.


def to_grey(image: np.ndarray) -> np.ndarray:
    return (image.astype(np.int64) @ (77, 150, 29) + 128) >> 8


def compute_reference_costs(left: np.ndarray, right: np.ndarray, lowest: int, count: int) -> np.ndarray:
    height, width = left.shape[:2]

    def described(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        grey = to_grey(image)
        padded = np.pad(grey, ((2, 2), (3, 3)), mode="edge")
        bits = np.stack(
            [
                padded[2 + dy : 2 + dy + height, 3 + dx : 3 + dx + width] < grey
                for dy in range(-2, 3)
                for dx in range(-3, 4)
                if (dx, dy) != (0, 0)
            ],
            axis=-1,
        )
        own = np.pad(grey, 1, mode="edge")
        slopes = np.stack([own[1:-1, 2:] - own[1:-1, :-2], own[2:, 1:-1] - own[:-2, 1:-1]], axis=-1)
        return bits, slopes

    (bits, slopes), (bits_right, slopes_right) = described(left), described(right)
    costs = np.full((height, width, count), -1)
    for x in range(width):
        for d in range(count):
            there = x - d - lowest
            if 0 <= there < width:
                unlike = (bits[:, x] != bits_right[:, there]).sum(axis=-1)
                levels = np.minimum(np.abs(slopes[:, x] - slopes_right[:, there]).sum(axis=-1), 40)
                costs[:, x, d] = (unlike * (120 * 256 // 34) + levels * (20 * 256 // 40)) >> 8
        inside = np.flatnonzero(costs[0, x] >= 0)
        if not len(inside):
            costs[:, x] = 70
            continue
        first, last = inside[[0, -1]]
        costs[:, x, :first] = np.maximum(costs[:, x, first], 70)[:, None]
        costs[:, x, last + 1 :] = np.maximum(costs[:, x, last], 70)[:, None]
    return costs


def compute_reference_average(image: np.ndarray, costs: np.ndarray) -> np.ndarray:
    height, width = image.shape[:2]
    levels = image.astype(int)

    def line(y: int, x: int, step: tuple[int, int]) -> list[tuple[int, int]]:
        found = []
        for k in range(1, 6):
            v, u = y + k * step[0], x + k * step[1]
            if not (0 <= v < height and 0 <= u < width):
                break
            last = found[-1] if found else (y, x)
            most = 20 if k <= 2 else 20 // 3
            if (
                np.abs(levels[v, u] - levels[y, x]).max() > most
                or np.abs(levels[v, u] - levels[last]).max() > 20
            ):
                break
            found.append((v, u))
        return found

    for ways in (((0, -1), (0, 1)), ((-1, 0), (1, 0))):
        averaged = np.zeros_like(costs)
        for y in range(height):
            for x in range(width):
                cross = [(y, x), *line(y, x, ways[0]), *line(y, x, ways[1])]
                total = sum(costs[place] for place in cross)
                averaged[y, x] = total if len(cross) == 1 else (total * (65536 // len(cross))) >> 16
        costs = averaged
    return costs


def compute_reference_sums(image: np.ndarray, costs: np.ndarray) -> np.ndarray:
    height, width, _ = costs.shape
    grey = to_grey(image)
    sums = np.zeros_like(costs)
    for dy, dx in ((0, 1), (0, -1), (1, -1), (1, 0), (1, 1), (-1, -1), (-1, 0), (-1, 1)):
        reached = np.zeros_like(costs)
        for y in range(height)[:: -1 if dy < 0 else 1]:
            for x in range(width)[:: -1 if dx < 0 else 1]:
                v, u = y - dy, x - dx
                if not (0 <= v < height and 0 <= u < width):
                    reached[y, x] = costs[y, x]
                    continue
                last = reached[v, u]
                levels = np.float32(abs(grey[y, x] - grey[v, u]))
                large = max(int(np.float32(LARGE) / (1 + levels / np.float32(EDGE))), SMALL + 1)
                beside = np.pad(last, 1, constant_values=10**6)
                best = np.minimum(last, np.minimum(beside[:-2], beside[2:]) + SMALL)
                reached[y, x] = costs[y, x] + np.minimum(best, last.min() + large) - last.min()
        sums += reached
    return sums


@pytest.mark.slow
@pytest.mark.parametrize(("height", "width", "lowest"), [(9, 30, 0), (12, 21, -5), (5, 9, 3)])
def test_the_kernel_agrees_with_the_reference(height: int, width: int, lowest: int) -> None:
    rng = np.random.default_rng(height)
    left, right = make_shifted_pair(rng.integers(0, 6, (height, width)))
    costs = compute_reference_average(left, compute_reference_costs(left, right, lowest, 16))
    sums = compute_reference_sums(left, costs)
    disparity, of_right, least, margin, cost = match_pair(left, right, lowest=lowest)
    best = sums.argmin(axis=2)
    np.testing.assert_array_equal(np.rint(np.abs(disparity - best - lowest) - 1e-6), 0)
    np.testing.assert_array_equal(least, sums.min(axis=2))
    np.testing.assert_array_equal(cost, np.take_along_axis(costs, best[..., None], 2)[..., 0])
    for y in range(height):
        for x in range(width):
            others = np.delete(sums[y, x], slice(max(best[y, x] - 1, 0), best[y, x] + 2))
            assert margin[y, x] == others.min() - least[y, x]
            facing = [(sums[y, x + d + lowest, d], d) for d in range(16) if 0 <= x + d + lowest < width]
            if facing:
                assert sums[y, x + int(of_right[y, x]), int(of_right[y, x]) - lowest] == min(facing)[0]
            else:
                assert np.isnan(of_right[y, x])


@settings(max_examples=20, deadline=None)
@given(
    st.integers(1, 24), st.integers(1, 40), st.integers(-20, 20), st.integers(1, 3), st.integers(0, 2**32 - 1)
)
def test_results_do_not_depend_on_threads_for_any_size(
    height: int, width: int, lowest: int, steps: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    pair = rng.integers(0, 256, (2, height, width, 3), np.uint8)
    one = match_pair(*pair, lowest=lowest, count=16 * steps)
    for other in (match_pair(*pair, threads=t, lowest=lowest, count=16 * steps) for t in (2, 5)):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("channels", [1, 3])
def test_a_slanted_plane_and_a_step_are_found(channels: int) -> None:
    height, width = 80, 160
    truth = np.tile(np.linspace(4, 12, width), (height, 1))
    truth[20:60, 60:110] = 20
    pair = make_shifted_pair(truth, 1)
    if channels == 1:
        pair = tuple(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in pair)  # type: ignore[assignment]
    found = stereo_disparity(*pair, 31)
    assert found.disparity.dtype == found.confidence.dtype == np.float32
    sure = np.isfinite(found.disparity)
    assert sure[:, 40:].mean() > 0.85
    errors = np.abs(found.disparity - truth)[sure]
    assert np.median(errors) < 0.2
    assert (errors > 2).mean() < 0.02
    np.testing.assert_array_equal(sure, found.confidence >= 0.8)


def test_a_higher_confidence_bound_gives_less_disparity() -> None:
    pair = make_shifted_pair(np.tile(np.linspace(2, 14, 120), (60, 1)), 2)
    everything, some, few = (stereo_disparity(*pair, 15, min_confidence=c) for c in (0, 0.8, 0.97))
    assert np.isfinite(everything.disparity).all()
    assert np.isfinite(some.disparity).sum() > np.isfinite(few.disparity).sum() > 0
    np.testing.assert_array_equal(everything.confidence, few.confidence)


def test_negative_disparities_stay_in_the_requested_range() -> None:
    truth = np.full((40, 90), -3.0)
    found = stereo_disparity(*make_shifted_pair(truth, 3), 1, min_disparity=-8)
    inner = found.disparity[5:-5, 15:-15]
    assert np.nanmedian(inner) == pytest.approx(-3, abs=0.1)
    assert np.nanmax(found.disparity) <= 1.5
    assert np.nanmin(found.disparity) >= -8.5


@pytest.mark.parametrize(
    ("change", "error", "said"),
    [
        ({"right": np.zeros((4, 6, 3), np.uint8)}, InputError, "differ in size: 5 × 4 and 6 × 4"),
        ({"left": np.zeros((4, 5, 4), np.uint8)}, InputError, r"the left image is \(4, 5, 4\) uint8"),
        ({"left": np.zeros((4, 5), np.float32)}, InputError, r"the left image is \(4, 5\) float32"),
        ({"left": np.zeros((0, 5), np.uint8)}, InputError, r"the left image is \(0, 5\) uint8"),
        ({"max_disparity": -1}, UsageError, "max_disparity is -1 px; it must be from min_disparity"),
        ({"max_disparity": 10**5}, UsageError, "max_disparity is 100000 px"),
        ({"min_confidence": 1.5}, UsageError, "min_confidence is 1.5; it must be from 0 to 1"),
    ],
)
def test_invalid_pairs_are_refused(change: dict[str, Any], error: type[Exception], said: str) -> None:
    given = {
        "left": np.zeros((4, 5, 3), np.uint8),
        "right": np.zeros((4, 5, 3), np.uint8),
        "max_disparity": 8,
    }
    with pytest.raises(error, match=said):
        stereo_disparity(**given | change)


def read_middlebury(shared_data: Path, name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    if name == "Motorcycle":
        folder = shared_data / "stereo" / "middlebury2014_motorcycle"
        truth = cv2.imread(str(folder / "disp0.pfm"), cv2.IMREAD_UNCHANGED)
        images = [read_rgb(folder / file) for file in ("im0.png", "im1.png")]
        return images[0], images[1], truth, 69
    folder = shared_data / "stereo" / "middlebury2003_cones"
    truth = cv2.imread(str(folder / "disp2.pgm"), cv2.IMREAD_UNCHANGED) / 4.0
    truth[truth == 0] = np.inf
    images = [read_rgb(next(folder.glob(f"{file}.*"))) for file in ("im2", "im6")]
    return images[0], images[1], truth, 63


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "covered", "wrong", "all_wrong"),
    [("Motorcycle", 0.95, 0.0152, 0.028), ("Cones", 0.95, 0.0155, 0.026)],
)
def test_real_pairs(shared_data: Path, name: str, covered: float, wrong: float, all_wrong: float) -> None:
    left, right, truth, most = read_middlebury(shared_data, name)
    seen = mask_visible(truth)
    found = stereo_disparity(left, right, most, min_confidence=0)
    off = np.abs(found.disparity - np.where(seen, truth, 0)) > 2
    sure = found.confidence >= 0.8
    assert (off & seen).sum() <= all_wrong * seen.sum()
    assert (sure & seen).sum() >= covered * seen.sum()
    assert (off & sure & seen).sum() <= wrong * seen.sum()
    # Confidence values are calibrated within a few percent.
    known = np.isfinite(truth)
    off = np.abs(found.disparity - np.where(known, truth, 0)) > 2
    for low, high in ((0.2, 0.5), (0.5, 0.8), (0.8, 0.95), (0.95, 1)):
        chosen = known & (found.confidence >= low) & (found.confidence < high)
        assert found.confidence[chosen].mean() == pytest.approx((~off[chosen]).mean(), abs=0.15)


@pytest.mark.slow
def test_streets(shared_data: Path) -> None:
    folder = shared_data / "real" / "kitti_stereo_2015"
    covered, wrong = [], []
    for path in sorted((folder / "image_2").glob("*_10.png")):
        truth = cv2.imread(str(folder / "disp_occ_0" / path.name), cv2.IMREAD_UNCHANGED) / 256.0
        pair = [read_rgb(folder / side / path.name) for side in ("image_2", "image_3")]
        found = stereo_disparity(pair[0], pair[1], 127)
        given = (truth > 0) & np.isfinite(found.disparity)
        covered.append(given.sum() / (truth > 0).sum())
        wrong.append((np.abs(found.disparity - truth)[given] > 3).mean())
    assert np.mean(covered) >= 0.85
    assert np.mean(wrong) <= 0.03


def make_rig(width: int, height: int) -> StereoRig:
    camera = Camera(width, height, 100.0, 100.0, width / 2, height / 2)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = -0.1
    return StereoRig(camera, camera, right_from_left, is_rectified=True)


def test_the_stage_accepts_the_matcher() -> None:
    truth = np.tile(np.linspace(4, 12, 160), (80, 1))
    left, right = make_shifted_pair(truth, 4)
    found = depth(
        left, right, make_rig(160, 80), matcher="census", disparities=32, max_relative_depth_error=1
    )
    measured = found.depth > 0
    assert measured[:, 20:].mean() > 0.95
    off = np.abs(found.depth * truth / (100 * 0.1) - 1)[measured]
    assert np.median(off) < 0.02
    np.testing.assert_array_equal(measured, found.confidence >= 204)
    fewer = depth(left, right, make_rig(160, 80), matcher="census", disparities=32, min_confidence=252)
    assert (fewer.depth > 0).sum() < measured.sum()


def test_unsupported_options_are_refused() -> None:
    with pytest.raises(UsageError, match=r"sgbm\.p1 has no effect with matcher census; omit"):
        stages.DepthParams(matcher="census", sgbm=stages.SgbmParams(smooth=True, p1=5))
    with pytest.raises(UsageError, match="speckle_size has no effect with matcher census; omit"):
        stages.DepthParams(matcher="census", speckle_size=5)
