"""Mutual nearest descriptors, compared with a brute-force search over all pairs; places of keypoints."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.frames.features import compute_root_sift, detect_keypoints, match_descriptors


def make_descriptors(rng: np.random.Generator, count: int) -> NDArray[np.uint8]:
    """Draw descriptors with mostly small values, like SIFT's."""
    return (rng.random((count, 128)) ** 6 * 255).astype(np.uint8)


@given(
    seed=st.integers(0, 10_000), there=st.integers(0, 150), more=st.integers(0, 150), off=st.integers(0, 90)
)
@settings(max_examples=60, deadline=None)
def test_matches_agree_with_brute_force(seed: int, there: int, more: int, off: int) -> None:
    rng = np.random.default_rng(seed)
    source = make_descriptors(rng, there)
    seen_again = (source[::-1].astype(int) + rng.integers(0, off + 1, source.shape)).clip(0, 255)
    target = np.concatenate([seen_again.astype(np.uint8), make_descriptors(rng, more)])
    found = {(int(a), int(b)) for a, b in match_descriptors(source, target)}
    if there == 0 or len(target) < 2:
        assert not found
        return
    likeness = compute_root_sift(source).astype(np.float64) @ compute_root_sift(target).T
    first, second = np.sort(2 - 2 * likeness, axis=1)[:, :2].T
    nearest, back = likeness.argmax(axis=1), likeness.argmax(axis=0)
    margin = np.sqrt(first.clip(0)) - 0.8 * np.sqrt(second)
    for one in range(there):
        # The kernel rounds roots to 1/16384, so pairs this close to the ratio threshold may go either way.
        if abs(margin[one]) > 1e-3:
            is_match = margin[one] < 0 and back[nearest[one]] == one
            assert ((one, int(nearest[one])) in found) == is_match


@pytest.mark.parametrize(("shape", "distinct"), [((3, 64), 0.8), ((3, 128), 0.0), ((3, 128), float("nan"))])
def test_invalid_descriptors_are_refused(shape: tuple[int, int], distinct: float) -> None:
    with pytest.raises(ValueError, match=r"128 is expected|more than 0"):
        _kernels.match_descriptors(
            np.zeros(shape, np.uint8), np.zeros(shape, np.uint8), max_distance_ratio=distinct
        )


@pytest.mark.parametrize("size", [(480, 640), (361, 641)])
def test_keypoints_without_doubling_are_at_the_same_places(size: tuple[int, int]) -> None:
    v, u = np.indices(size, np.float64)
    rng = np.random.default_rng(3)
    centers = np.array([(x, y) for x in range(40, size[1] - 40, 60) for y in range(40, size[0] - 40, 60)])
    centers = centers + rng.uniform(-10, 10, centers.shape)
    image = np.full(size, 60.0)
    for x, y in centers:
        image += 120 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / (2 * 4.0**2))
    found = detect_keypoints(np.asarray(image.clip(0, 255), np.uint8), 1000, is_doubled=False).pixels
    distances = np.linalg.norm(found[:, None] - centers[None], axis=2).min(axis=0)
    assert (distances < 0.05).mean() > 0.95
