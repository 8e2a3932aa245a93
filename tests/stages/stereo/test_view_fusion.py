"""Fusion of depth maps: comparison with a reference implementation, and a known scene."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import _kernels
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.sweep_confidence import compute_fused_confidence
from scanloom.stages.stereo.view_fusion import FusedDepth, fuse_views
from tests.made import posed_scene

NARROW, WIDE = np.float32(0.05), np.float32(0.2)


def render_reference(
    view: PosedView, other: PosedView, depth: np.ndarray, trust: np.ndarray
) -> dict[tuple[int, int], tuple[float, int]]:
    """Render a depth map into a view, pixel by pixel."""
    rendered: dict[tuple[int, int], tuple[float, int]] = {}
    for v, u in np.ndindex(depth.shape):
        z = float(depth[v, u])
        if z <= 0:
            continue
        point = other.to_world(other.compute_rays(np.array(float(u)), np.array(float(v))) * z)
        x, y, ahead = (float(n) for n in view.project(point))
        at = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
        inside = 0 <= at[0] < view.camera.height and 0 <= at[1] < view.camera.width
        if inside and (at not in rendered or ahead < rendered[at][0]):
            rendered[at] = ahead, int(trust[v, u])
    return rendered


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_kernel_agrees_with_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    camera = replace(posed_scene.CAMERA, width=12, height=9, cx=5.5, cy=4.0, fx=10.0, fy=11.0)
    views = [
        PosedView(camera, posed_scene.pose(float(rng.uniform(-20, 20)), float(rng.uniform(-9, 9))), 0.5, 4.0)
        for _ in range(rng.integers(1, 6))
    ]
    maps = [rng.choice([0, 1.0, 1.41, 1.5, 1.63, 2.2], (9, 12)).astype(np.float32) for _ in views]
    trusts = [rng.integers(0, 256, (9, 12), dtype=np.uint8) for _ in views]
    others = list(zip(views[1:], maps[1:], trusts[1:], strict=True))

    fused = fuse_views(views[0], maps[0], trusts[0], others, float(NARROW), float(WIDE))
    again = fuse_views(views[0], maps[0], trusts[0], others, float(NARROW), float(WIDE), threads=2)

    for name, values in vars(fused).items():
        np.testing.assert_array_equal(values, getattr(again, name))
    rendered = [render_reference(views[0], *one) for one in others]
    for v, u in np.ndindex(maps[0].shape):
        found = [(float(maps[0][v, u]), int(trusts[0][v, u]))] if maps[0][v, u] > 0 else []
        found += [one[v, u] for one in rendered if (v, u) in one]
        if not found:
            assert fused.depth[v, u] == 0
            continue
        sums = []
        for z, _ in found:
            agreeing = sum(trust for other, trust in found if abs(other - z) <= WIDE * z)
            in_front = sum(trust for other, trust in found if other < (1 - WIDE) * z)
            sums.append((agreeing - in_front, z))
        best = max(sums)[0]
        means = []
        for _, z in (one for one in sums if one[0] == best):
            near = [(other, trust) for other, trust in found if abs(other - z) <= NARROW * z]
            total = sum(trust for _, trust in near)
            means.append(sum(other * trust for other, trust in near) / total if total else z)
        depth = float(fused.depth[v, u])
        assert min(abs(depth - mean) for mean in means) < 1e-5
        point = views[0].to_world(views[0].compute_rays(np.array(float(u)), np.array(float(v))) * depth)
        confirming = contradicting = 0
        counts = [0, 0]
        for other, there, trust in others:
            x, y, ahead = (float(n) for n in other.project(point))
            if not other.contains(np.array(x), np.array(y)):
                continue
            at = int(np.floor(y + 0.5)), int(np.floor(x + 0.5))
            if there[at] > 0 and abs(there[at] / ahead - 1) <= WIDE:
                confirming += int(trust[at])
                counts[0] += 1
                counts[1] += int(abs(there[at] / ahead - 1) <= NARROW)
            elif there[at] > ahead:
                contradicting += int(trust[at])
        assert (fused.confirming[v, u], fused.contradicting[v, u]) == (confirming, contradicting)
        assert [fused.nearly_consistent[v, u], fused.consistent[v, u]] == counts


def test_bad_input_is_refused() -> None:
    depth, trust = np.ones((2, 3), np.float32), np.zeros((2, 3), np.uint8)
    other = (np.eye(3, 4), np.eye(3, 4), depth, trust)
    for tolerances in ((0.0, 0.1), (0.2, 0.1), (0.1, np.inf), (np.nan, 0.1)):
        with pytest.raises(ValueError, match="tolerances"):
            _kernels.fuse_depth_maps(depth, trust, [other], tolerances=tolerances, wanted_threads=1)
    for odd in ((other[0][:2], *other[1:]), (other[0], other[1][:2], *other[2:])):
        with pytest.raises(ValueError, match="3 × 4"):
            _kernels.fuse_depth_maps(depth, trust, [odd], tolerances=(0.1, 0.1), wanted_threads=1)
    with pytest.raises(ValueError, match="different sizes"):
        _kernels.fuse_depth_maps(depth, trust[:1], [other], tolerances=(0.1, 0.1), wanted_threads=1)


def make_true_views(count: int) -> list[tuple[PosedView, np.ndarray, np.ndarray]]:
    views = []
    for number in range(count):
        where = posed_scene.pose(7.0 * number, 0)
        true = posed_scene.render_view(where)[1].astype(np.float32)
        views.append(
            (PosedView(posed_scene.CAMERA, where, 0.5, 4.0), true, np.full(true.shape, 200, np.uint8))
        )
    return views


def test_errors_of_one_view_are_replaced() -> None:
    (view, true, trust), *others = make_true_views(4)
    wrong = true.copy()
    wrong[50:90, 80:150] *= 0.8
    wrong[20:30] = 0
    fused = fuse_views(view, wrong, trust, others, 0.01, 0.025)
    shown = (true > 0) & (fused.nearly_consistent == 3)
    assert shown[50:90, 80:150].mean() > 0.6
    assert np.median(np.abs(fused.depth / np.maximum(true, 1e-6) - 1)[shown]) < 0.002
    assert np.mean(np.abs(fused.depth / np.maximum(true, 1e-6) - 1)[shown] < 0.02) > 0.99


def test_a_view_without_others_keeps_its_depth() -> None:
    ((view, true, trust),) = make_true_views(1)
    fused = fuse_views(view, true, trust, [], 0.01, 0.025)
    np.testing.assert_allclose(fused.depth, true, rtol=1e-6)
    assert not fused.consistent.any()
    assert not fused.contradicting.any()


def test_fused_confidence_increases_with_evidence() -> None:
    rng = np.random.default_rng(3)
    grey = rng.integers(0, 256, (40, 60), dtype=np.uint8)
    depth = np.full((40, 60), 2.0, np.float32)
    depth[:, :5] = 0

    def rate(
        confirming: int, contradicting: int = 0, image: np.ndarray = grey, is_outlined: bool = False
    ) -> np.ndarray:
        def fill(views: int, dtype: type = np.uint16) -> np.ndarray:
            return np.full((40, 60), views, dtype)

        same, past = fill(200 * confirming), fill(200 * contradicting)
        counts = fill(confirming, np.uint8)
        fused = FusedDepth(depth, same, past, counts, counts)
        return compute_fused_confidence(fused, image, is_outlined)

    assert not rate(4)[:, :5].any()
    inner = np.s_[10:30, 20:40]
    assert (rate(8)[inner] > rate(2)[inner]).all()
    assert (rate(4)[inner] > rate(4, 6)[inner]).all()
    flat = np.full_like(grey, 200)
    assert (rate(4)[inner] > rate(4, 0, flat)[inner]).all()
    assert (rate(4, 0, flat, is_outlined=True)[inner] > rate(4, 0, flat)[inner]).all()
