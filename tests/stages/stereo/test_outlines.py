"""A pale object in front of a backdrop, masked objects, and reports of low depth coverage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pale_object
import pytest

from scanloom import views_depth
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.stereo.background import detect_backdrop, segment_foreground
from scanloom.stages.stereo.codes import DEPTH_COVERAGE_LOW, DEPTH_OBJECT_INCOMPLETE
from scanloom.stages.stereo.coverage import CoverageCounts, report_coverage
from scanloom.stages.stereo.depth import DepthMap, DepthParams
from scanloom.stages.stereo.foreground_masks import compute_hull_entry, crop_to_hull, detect_outline
from scanloom.stages.stereo.posed_views import create_posed_views
from scanloom.stages.stereo.visual_hull_filling import compute_hull_depth, remove_contradicted_depth

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def pale() -> tuple[Scan, list[np.ndarray]]:
    return pale_object.make_pale_scan(views=9)


def collect_coverage_reports(counts: CoverageCounts, **changes: str) -> list[str]:
    with collecting() as diagnostics:
        report_coverage(counts, DepthParams(**changes))
    return list(map(str, diagnostics))


def compute_depth(scan: Scan, **changes: float) -> list[tuple[Frame, DepthMap]]:
    results = list(views_depth(scan, **changes))
    assert all(isinstance(result, DepthMap) for _, result in results)
    return results


def test_a_pale_object_on_black_keeps_its_depth(pale: tuple[Scan, list[np.ndarray]]) -> None:
    """A texture threshold alone would remove most of the object, whose texture has two grey levels."""
    scan, truths = pale
    results = compute_depth(scan)
    for (_, result), true in list(zip(results, truths, strict=True))[2:-2]:
        assert np.mean(result.depth[true > 0] > 0) > 0.8
        assert np.mean(result.depth[true == 0] > 0) < 0.002
        both = (result.depth > 0) & (true > 0)
        assert np.median(np.abs(result.depth - true)[both] / true[both]) < 0.01
        assert not result.diagnostics


def test_a_backdrop_is_distinguished_from_a_room_and_from_the_object(
    pale: tuple[Scan, list[np.ndarray]],
) -> None:
    scan, truths = pale
    images = [frame.color for frame in scan.frames]
    whole = [np.ones((240, 320), bool)] * len(images)
    found = detect_backdrop(images, whole)
    assert found is not None
    for image, true in zip(images, truths, strict=True):
        # Pixels on the outline are mixed.
        assert np.mean(segment_foreground(image, found, 3.0) != (true > 0)) < 0.002
    draw = np.random.default_rng(3)
    whole = [np.ones((90, 120), bool)] * 4
    rooms = [draw.integers(0, 255, (90, 120, 3), np.uint8) for _ in range(4)]
    assert detect_backdrop(rooms, whole) is None
    # Walls of a different colour in each view.
    assert detect_backdrop([np.full((90, 120, 3), 60 * at, np.uint8) for at in range(4)], whole) is None
    assert detect_backdrop([], []) is None


def test_black_borders_of_undistorted_images_are_not_a_backdrop() -> None:
    """A fox in a room was once taken for an object on black, and its dark parts for the backdrop."""
    draw = np.random.default_rng(3)
    seen = np.zeros((90, 120), bool)
    seen[8:-8, 8:-8] = True
    rooms = [draw.integers(40, 255, (90, 120, 3), np.uint8) * seen[..., None] for _ in range(4)]
    assert detect_backdrop(rooms, [seen] * 4) is None
    assert detect_backdrop(rooms, [np.ones_like(seen)] * 4) is not None


def add_masks(scan: Scan, truths: list[np.ndarray]) -> Scan:
    masks = [(true > 0).astype(np.uint8) * 255 for true in truths]
    frames = [replace(frame, mask=mask) for frame, mask in zip(scan.frames, masks, strict=True)]
    return replace(scan, frames=frames)


def test_the_front_of_the_hull_is_never_behind_the_object() -> None:
    scan, truths = pale_object.make_pale_scan(views=36)
    scan = add_masks(scan, truths)
    views = [replace(view, near=0.5, far=1.5) for view in create_posed_views(scan)]
    true = truths[5].astype(np.float32)
    front = compute_hull_entry(views[5], true > 0, detect_outline(scan, views, 3.0).silhouettes)
    assert not front[true == 0].any()
    ahead = (true - front)[true > 0] / true[true > 0]
    assert np.mean(front[true > 0] > 0) == 1
    assert ahead.min() > -0.005
    # A ring of views bounds the object from above and below only by their view cones.
    assert np.median(ahead) < 0.03


def test_unmeasured_surface_is_filled_near_the_hull() -> None:
    scan, truths = pale_object.make_pale_scan(views=36)
    scan = add_masks(scan, truths)
    views = [replace(view, near=0.5, far=1.5) for view in create_posed_views(scan)]
    outlines = detect_outline(scan, views, 3.0).silhouettes
    true = truths[5].astype(np.float32)
    hole = np.zeros(true.shape, bool)
    hole[100:150, 140:180] = True
    depth = np.where(hole, np.float32(0), true)
    told = compute_hull_depth(views[5], depth, true > 0, outlines)
    np.testing.assert_array_equal(told > 0, hole & (true > 0))
    off = np.abs(told - true)[told > 0] / true[told > 0]
    front = compute_hull_entry(views[5], told > 0, outlines)
    assert np.median(off) < 0.01
    # Closer to the object than the hull; the offset from the hull is estimated from measured surroundings.
    assert np.median(off) < 0.6 * np.median((true - front)[told > 0] / true[told > 0])
    # Depth that other views measured, at or behind the hole, contradicts filling.
    others = [(views[at], truths[at].astype(np.float32)) for at in (4, 6)]
    assert np.mean(remove_contradicted_depth(views[5], told, others, 2)[told > 0] > 0) < 0.1
    np.testing.assert_array_equal(remove_contradicted_depth(views[5], told, others, 3), told)


def test_an_object_with_hardly_any_texture_keeps_its_shape() -> None:
    """With less texture than noise, matches were arbitrary; the median error was 4 %."""
    scan, truths = pale_object.make_pale_scan(views=18, step=20.0, texture=0.5)
    off = []
    with collecting() as diagnostics:
        results = compute_depth(add_masks(scan, truths))
    assert [one.code for one in diagnostics] == [DEPTH_OBJECT_INCOMPLETE.name]
    for (_, result), true in zip(results, truths, strict=True):
        both = (result.depth > 0) & (true > 0)
        off.append(np.abs(result.depth - true)[both] / true[both])
    assert np.median(np.concatenate(off)) < 0.02


def test_many_unmeasured_pixels_are_reported() -> None:
    assert not collect_coverage_reports(
        CoverageCounts(total=100, foreground=50, consistent=40, hull_filled=4)
    )
    (said,) = collect_coverage_reports(
        CoverageCounts(total=100, foreground=50, consistent=30, hull_filled=10)
    )
    assert said.startswith("25% of the object's depth is not measured")
    (said,) = collect_coverage_reports(
        CoverageCounts(total=100, foreground=50, consistent=30, plane_filled=10)
    )
    assert said.startswith("25% of the depth is not measured, but filled from planes")


def test_object_masks_bound_the_depth(pale: tuple[Scan, list[np.ndarray]]) -> None:
    scan, truths = pale
    cut = add_masks(scan, truths)
    views = create_posed_views(cut)
    outline = detect_outline(cut, views, 3.0)
    assert len(outline.silhouettes) == 9
    true = truths[4].astype(np.float32)
    np.testing.assert_array_equal(crop_to_hull(true, views[4], outline.silhouettes), true)
    # At half of its depth closer, most of the object projects outside its silhouettes in the side views.
    wrong = true - np.float32(0.15) * (true > 0)
    assert np.mean(crop_to_hull(wrong, views[4], outline.silhouettes)[true > 0] > 0) < 0.7
    for (_, result), true in list(zip(compute_depth(cut), truths, strict=True))[2:-2]:
        assert np.mean(result.depth[true > 0] > 0) > 0.8


def test_other_masks_are_not_silhouettes(pale: tuple[Scan, list[np.ndarray]]) -> None:
    scan, truths = pale
    height, width = truths[0].shape
    moving = [(true == 0).astype(np.uint8) for true in truths]
    v, u = np.mgrid[:height, :width]
    lens = (np.hypot(u - width / 2, v - height / 2) < height / 2).astype(np.uint8)
    for masks in (moving, [lens] * len(truths)):
        frames = [replace(frame, mask=mask) for frame, mask in zip(scan.frames, masks, strict=True)]
        found = detect_outline(replace(scan, frames=frames), create_posed_views(scan), 3.0)
        assert not found.silhouettes
        assert found.backdrop is not None
        assert not detect_outline(replace(scan, frames=frames), create_posed_views(scan), 0.0).is_known


def test_low_coverage_is_reported_with_its_cause() -> None:
    pairs = {"views": "pairs"}
    assert not collect_coverage_reports(
        CoverageCounts(total=100, foreground=50, matched=40, consistent=30, outlined=100), **pairs
    )
    (said,) = collect_coverage_reports(
        CoverageCounts(total=100, foreground=50, matched=40, consistent=10, outlined=100), **pairs
    )
    assert "only 20% of the pixels inside masks or in front of the backdrop" in said
    assert "60% are not confirmed by 2 other views" in said
    assert said.index("60%") < said.index("20% have no reliable match")
    (said,) = collect_coverage_reports(
        CoverageCounts(total=100, foreground=100, textureless=80, matched=15, consistent=10), **pairs
    )
    assert (
        "10% of the views' pixels: 80% have too little texture (depth.max_backdrop_contrast=0 keeps them)"
        in said
    )
    assert not collect_coverage_reports(
        CoverageCounts(total=100, foreground=100, textureless=20, matched=70, consistent=16), **pairs
    )


def test_low_coverage_is_reported_once_per_scan(pale: tuple[Scan, list[np.ndarray]]) -> None:
    scan, _ = pale
    few = replace(scan, frames=scan.frames[:4])
    with collecting() as diagnostics:
        compute_depth(few, consistency_tolerance=1e-4)
    (said,) = [str(one) for one in diagnostics if one.code == DEPTH_COVERAGE_LOW.name]
    assert "have low confidence or are not confirmed by 2 other views (depth.min_confidence=128 and" in said
