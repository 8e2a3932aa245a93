"""Agreement of frames about the position of a surface, on planes with known errors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flat_plates import CAMERA, join_meshes, plate, render_frames

from scanloom import coverage
from scanloom.stages.inspecting.coverage.defect_kinds import WEAK_KINDS
from scanloom.stages.scans.model.scan import Frame

WALL = plate((-0.8, 0, 0), (1.6, 0, 0), (0, 0, 1.2))
STRAIGHT = [((x, -1.2, 0.6), (x, 0, 0.6)) for x in np.linspace(-0.3, 0.3, 6)]
ASLANT = [((x, -0.7, 0.6), (0, 0, 0.6)) for x in (-1.0, 0.7, 1.0)]


def offset_depth(frame: Frame, by: np.ndarray | float) -> Frame:
    """Add an error in metres to the depth of a frame."""
    depth = frame.depth + np.asarray(by, np.float32)
    return replace(frame, depth=np.where(frame.depth > 0, depth, np.float32(0)))


def test_exact_depth_has_no_spread_at_any_angle() -> None:
    found = coverage(WALL, render_frames(WALL, [*STRAIGHT, *ASLANT]))
    evidence = found.vertex_evidence
    assert evidence.frame_counts.max() == 9
    # Only at pixel centres: 1 cm off centre, the depth of a slope of 55° changes by 1.4 cm.
    assert evidence.rms_height.max() < 1e-5
    assert found.spread_95 < 1e-5


@pytest.mark.parametrize("sigma", [0.002, 0.008])
def test_the_spread_of_noisy_depth_is_its_noise(sigma: float) -> None:
    rng = np.random.default_rng(5)
    frames = [
        offset_depth(one, rng.normal(0, sigma, one.depth.shape)) for one in render_frames(WALL, STRAIGHT * 4)
    ]
    found = coverage(WALL, frames)
    often = found.vertex_evidence.frame_counts >= 20
    assert often.sum() > 1000
    assert np.sqrt((found.vertex_evidence.rms_height[often] ** 2).mean()) == pytest.approx(sigma, rel=0.03)
    assert found.spread_median == pytest.approx(sigma, rel=0.1)
    assert found.spread_median < found.spread_95 < 2 * sigma
    metrics = found.to_dict()
    assert (metrics["spread_median_m"], metrics["spread_95_m"]) == (found.spread_median, found.spread_95)


def test_two_contradicting_frames_deviate_by_half_their_difference() -> None:
    one = render_frames(WALL, [STRAIGHT[2]])[0]
    found = coverage(WALL, [offset_depth(one, 0.006), offset_depth(one, -0.006)])
    seen = found.vertex_evidence.frame_counts == 2
    assert seen.sum() > 1000
    np.testing.assert_allclose(found.vertex_evidence.rms_height[seen], 0.006, atol=1e-6)
    # A single frame deviates by its full error; without a frame there is no deviation.
    alone = coverage(WALL, [offset_depth(one, 0.006)])
    np.testing.assert_allclose(
        alone.vertex_evidence.rms_height[alone.vertex_evidence.frame_counts == 1], 0.006, atol=1e-6
    )
    assert (alone.vertex_evidence.rms_height[alone.vertex_evidence.frame_counts == 0] == 0).all()


def test_spread_is_along_the_normal_and_the_mean_angle_covers_all_frames() -> None:
    straight, aslant = render_frames(WALL, [((0, -1.2, 0.6), (0, 0, 0.6)), ((0.9, -0.9, 0.6), (0, 0, 0.6))])
    middle = np.abs(WALL.vertices - (0, 0, 0.6)).max(axis=1) < 0.02
    evidence = coverage(WALL, [straight, offset_depth(aslant, 0.01)]).vertex_evidence
    # The error is 1 cm along the optical axis, times the cosine along the normal; one of the two frames is
    # exact.
    np.testing.assert_allclose(evidence.rms_height[middle], 0.01 * np.cos(np.pi / 4) / np.sqrt(2), rtol=0.05)
    np.testing.assert_allclose(evidence.mean_cosine[middle], (1 + np.cos(np.pi / 4)) / 2, atol=0.02)
    np.testing.assert_allclose(evidence.max_cosine[middle], 1, atol=0.01)


def test_contradicting_frames_are_a_separate_defect() -> None:
    frames = render_frames(WALL, [STRAIGHT[2]] * 6)
    # On the left, every second frame has the wall 2 cm farther away.
    left = np.arange(CAMERA.width) < 30
    wrong = [offset_depth(one, 0.02 * left * (number % 2)) for number, one in enumerate(frames)]
    found = coverage(WALL, wrong, min_area=0.01)
    apart = found.vertex_kinds == WEAK_KINDS.index("apart")
    is_left = (found.vertex_evidence.frame_counts == 6) & (WALL.vertices[:, 0] < -0.35)
    assert is_left.sum() > 1000
    assert apart[is_left].all()
    np.testing.assert_allclose(found.vertex_evidence.rms_height[is_left], 0.02 / np.sqrt(2), rtol=1e-3)
    assert not apart[WALL.vertices[:, 0] > -0.3].any()
    assert 0.005 <= found.limits.max_spread < 0.01
    assert {place.kind for place in found.defects if place.point[0] < -0.35} >= {"apart"}
    assert found.weak_areas["apart"] > 0.05
    assert not (coverage(WALL, wrong, spread=0.03).vertex_kinds == WEAK_KINDS.index("apart")).any()
    # Less than half an edge length cannot be represented by the mesh.
    assert not (coverage(WALL, frames).vertex_kinds == WEAK_KINDS.index("apart")).any()


def test_occluded_frames_do_not_contribute() -> None:
    board = plate((-0.2, -0.5, 0.4), (0.4, 0, 0), (0, 0, 0.4))
    clear, hidden = (
        render_frames(WALL, [STRAIGHT[2]])[0],
        render_frames(join_meshes([WALL, board]), [STRAIGHT[3]])[0],
    )
    alone, both = (coverage(WALL, frames).vertex_evidence for frames in ([clear], [clear, hidden]))
    behind = np.abs(WALL.vertices - (0, 0, 0.6)).max(axis=1) < 0.15
    assert (both.frame_counts[behind] == 1).all()
    np.testing.assert_array_equal(both.rms_height[behind], alone.rms_height[behind])
    assert both.frame_counts.max() == 2
