"""Sub-plane refinement: comparison with a reference implementation, and degenerate input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import _kernels


def average(values: np.ndarray) -> np.ndarray:
    wide = np.pad(values, 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(wide, (5, 5))
    return np.asarray(windows.mean(axis=(2, 3)))


def sample(image: np.ndarray, u: float, v: float, ahead: float) -> float:
    bottom, right = (n - 1 for n in image.shape)
    if not (ahead > 0 and 0 <= u <= right and 0 <= v <= bottom):
        return np.nan
    x, y = int(u), int(v)
    next_x, next_y = min(x + 1, right), min(y + 1, bottom)
    above, below = (
        float(row[x]) + (u - x) * (float(row[next_x]) - float(row[x])) for row in (image[y], image[next_y])
    )
    return above + (v - y) * (below - above)


def refine_by_reference(grey, partners, inverse, step) -> np.ndarray:
    own = grey - average(grey.astype(float))
    sums = np.zeros((3, *grey.shape))
    for matrix, image in partners:
        costs = []
        for offset in (-step / 2, 0, step / 2):
            warped = np.zeros(grey.shape)
            for v, u in np.ndindex(grey.shape):
                x, y, ahead = matrix @ (u, v, 1, inverse[v, u] + offset)
                warped[v, u] = sample(image, x / ahead, y / ahead, ahead)
            costs.append(average((warped - average(warped) - own) ** 2))
        cost = np.stack(costs)
        sums += np.nan_to_num(cost / (30 + cost.sum(axis=0)))
    behind, here, before = sums
    curvature = behind + before - 2 * here
    fraction = np.clip((behind - before) / np.where(curvature == 0, 1, 2 * curvature), -1, 1)
    return np.where(curvature > 0.5 / 30, inverse + step / 2 * fraction, inverse)


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_kernel_agrees_with_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grey = rng.integers(0, 256, rng.integers(1, 12, 2), dtype=np.uint8)
    inverse = rng.uniform(0.5, 1, grey.shape).astype(np.float32)
    partners = []
    for _ in range(rng.integers(1, 4)):
        matrix = np.eye(3, 4) + rng.normal(0, 0.01, (3, 4))
        matrix[:, 3] += rng.uniform(-2, 2), rng.uniform(-2, 2), 0
        partners.append((matrix, rng.integers(0, 256, rng.integers(1, 14, 2), dtype=np.uint8)))
    found = _kernels.refine_inverse_depth(grey, partners, inverse, step=0.2, wanted_threads=1)
    np.testing.assert_allclose(found, refine_by_reference(grey, partners, inverse, 0.2), atol=1e-3)


def test_threads_give_the_same_bits() -> None:
    rng = np.random.default_rng(4)
    # More rows than a band of the kernel.
    grey = rng.integers(0, 256, (150, 40), dtype=np.uint8)
    inverse = rng.uniform(0.5, 1, grey.shape).astype(np.float32)
    matrix = np.eye(3, 4)
    matrix[0, 3] = 2
    one, two = (
        _kernels.refine_inverse_depth(grey, [(matrix, grey)], inverse, step=0.2, wanted_threads=threads)
        for threads in (1, 2)
    )
    np.testing.assert_array_equal(one, two)
    np.testing.assert_allclose(
        one[60:70],
        _kernels.refine_inverse_depth(
            grey[50:80], [(matrix, grey[50:80])], inverse[50:80], step=0.2, wanted_threads=1
        )[10:20],
        atol=1e-6,
    )


def test_plain_and_unseen_pixels_keep_their_depth() -> None:
    inverse = np.full((9, 9), 0.5, np.float32)
    plain = np.full((9, 9), 90, np.uint8)
    noise = np.random.default_rng(2).integers(0, 256, (9, 9), dtype=np.uint8)
    away = np.eye(3, 4)
    away[0, 3] = 1000
    for grey, partners in ((plain, [(np.eye(3, 4), plain)]), (noise, [(away, noise)]), (noise, [])):
        found = _kernels.refine_inverse_depth(grey, partners, inverse, step=0.2, wanted_threads=1)
        np.testing.assert_array_equal(found, inverse)


def test_maps_of_other_sizes_are_refused() -> None:
    grey = np.zeros((4, 5), np.uint8)
    with pytest.raises(ValueError, match="different sizes"):
        _kernels.refine_inverse_depth(grey, [], np.zeros((4, 4), np.float32), step=1.0, wanted_threads=1)
    with pytest.raises(ValueError, match="3 × 4"):
        _kernels.refine_inverse_depth(
            grey, [(np.eye(3), grey)], np.zeros((4, 5), np.float32), step=1.0, wanted_threads=1
        )
