"""Plane sweep: comparison with a reference implementation, and known scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages import _kernels
from scanloom.stages.stereo.plane_sweep import sweep_view
from scanloom.stages.stereo.posed_views import PosedView
from scanloom.stages.stereo.sweep_confidence import compute_sweep_confidence
from scanloom.stages.stereo.view_consistency import ViewSupport
from scanloom.stages.stereo.view_images import ViewImage
from tests.made import posed_scene

SMALL, LARGE, EDGE = 24, 300.0, 30.0


def compute_census_and_gradient(grey: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    h, w = grey.shape
    wide = np.pad(grey, ((2, 2), (3, 3)), mode="edge").astype(int)
    own = wide[2 : 2 + h, 3 : 3 + w]
    bits = [
        wide[2 + y : 2 + y + h, 3 + x : 3 + x + w] < own
        for y in range(-2, 3)
        for x in range(-3, 4)
        if (x, y) != (0, 0)
    ]
    across = wide[2 : 2 + h, 4 : 4 + w] - wide[2 : 2 + h, 2 : 2 + w]
    down = wide[3 : 3 + h, 3 : 3 + w] - wide[1 : 1 + h, 3 : 3 + w]
    return np.stack(bits, -1), np.trunc(np.stack([across, down], -1) / 2).astype(int)


def compute_reference_costs(grey, partners, first, count) -> dict[tuple[int, int], np.ndarray]:
    own_bits, own_gradient = compute_census_and_gradient(grey)
    described = [compute_census_and_gradient(one[0]) for one in partners]
    result = {}
    for y, x in np.ndindex(grey.shape):
        costs = []
        for d in range(first[y, x], first[y, x] + count[y, x]):
            said, is_empty = [], False
            for (image, shown, maps), (bits, gradient) in zip(partners, described, strict=True):
                scale, right, down = maps[d]
                u = int(np.floor(np.float32(np.float32(scale * np.float32(x)) + right) + np.float32(0.5)))
                v = int(np.floor(np.float32(np.float32(scale * np.float32(y)) + down) + np.float32(0.5)))
                if not (0 <= u < image.shape[1] and 0 <= v < image.shape[0]):
                    continue
                if shown[v, u] == 2:
                    is_empty = True
                elif shown[v, u] == 1:
                    differing = int(np.count_nonzero(bits[v, u] != own_bits[y, x]))
                    levels = 2 * int(np.abs(gradient[v, u] - own_gradient[y, x]).sum())
                    said.append((differing * (120 * 256 // 34) + min(levels, 40) * 128) >> 8)
            best = sorted(said)[: min((len(said) + 1) // 2, 3)]
            costs.append(140 if is_empty else sum(best) // len(best) if best else 70)
        result[y, x] = np.array(costs)
    return result


def compute_reference_sums(grey, costs, first) -> dict[tuple[int, int], np.ndarray]:
    sums = {at: np.zeros(len(cost), int) for at, cost in costs.items()}
    h, w = grey.shape
    for way in ((0, 1), (0, -1), (1, 0), (-1, 0), (1, 1), (1, -1), (-1, 1), (-1, -1)):
        reached: dict[tuple[int, int], np.ndarray] = {}
        for y in range(h)[:: way[0] or 1]:
            for x in range(w)[:: way[1] or 1]:
                before = (y - way[0], x - way[1])
                own = costs[y, x].copy()
                if before in costs:
                    last = reached[before]
                    levels = abs(int(grey[y, x]) - int(grey[before]))
                    change = max(
                        int(np.float32(LARGE) / (1 + np.float32(levels) / np.float32(EDGE))), SMALL + 1
                    )
                    shift = int(first[y, x]) - int(first[before])

                    def cost_at(d: int, last: np.ndarray = last) -> float:
                        return last[d] if 0 <= d < len(last) else np.inf

                    for d in range(len(own)):
                        at = d + shift
                        best = min(
                            cost_at(at), cost_at(at - 1) + SMALL, cost_at(at + 1) + SMALL, last.min() + change
                        )
                        own[d] += best - last.min()
                reached[y, x] = own
                sums[y, x] += own
    return sums


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_kernel_agrees_with_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    h, w, planes = (int(n) for n in (rng.integers(1, 7), rng.integers(1, 9), 16 * rng.integers(1, 4)))
    grey = rng.integers(0, 256, (h, w), dtype=np.uint8)
    partners = []
    for _ in range(rng.integers(1, 8)):
        size = rng.integers(1, 12, 2)
        maps = np.stack(
            [rng.uniform(0.7, 1.4, planes), rng.uniform(-6, 6, planes), rng.uniform(-6, 6, planes)], axis=1
        ).astype(np.float32)
        image = rng.integers(0, 256, size, dtype=np.uint8)
        partners.append((image, rng.choice([0, 1, 1, 1, 2], size).astype(np.uint8), maps))
    count = (16 * rng.integers(1, planes // 16 + 1, (h, w))).astype(np.uint16)
    first = rng.integers(0, planes - count.astype(int) + 1).astype(np.int32)

    plane, margin = _kernels.sweep_planes(grey, partners, first, count, planes=planes, wanted_threads=1)
    again = _kernels.sweep_planes(grey, partners, first, count, planes=planes, wanted_threads=2)

    for one, other in zip((plane, margin), again, strict=True):
        np.testing.assert_array_equal(one, other)
    costs = compute_reference_costs(grey, partners, first, count)
    sums = compute_reference_sums(grey, costs, first)
    for y, x in np.ndindex(grey.shape):
        best = int(np.argmin(sums[y, x]))
        assert abs(plane[y, x] - (first[y, x] + best)) <= 0.5
        others = [s for d, s in enumerate(sums[y, x]) if abs(d - best) > 1]
        assert margin[y, x] == min(others) - sums[y, x][best]


def test_ranges_beyond_the_planes_are_refused() -> None:
    grey = np.zeros((2, 3), np.uint8)
    for first, count in ((1, 16), (-1, 16), (0, 15), (0, 0), (0, 32)):
        with pytest.raises(ValueError, match="planes"):
            _kernels.sweep_planes(
                grey,
                [],
                np.full((2, 3), first, np.int32),
                np.full((2, 3), count, np.uint16),
                planes=16,
                wanted_threads=1,
            )


def make_posed_views(count: int) -> tuple[list[ViewImage], list[np.ndarray]]:
    views, truths = [], []
    for number in range(count):
        where = posed_scene.pose(7.0 * number, 0)
        image, true = posed_scene.render_view(where)
        views.append(
            ViewImage(PosedView(posed_scene.CAMERA, where, 0.5, 4.0), image.mean(axis=-1).astype(np.uint8))
        )
        truths.append(true)
    return views, truths


def test_a_known_scene_is_measured_to_a_fraction_of_a_pixel() -> None:
    views, truths = make_posed_views(5)
    found = sweep_view(views[2], [views[at] for at in (1, 3, 0, 4)])
    shown = truths[2] > 0
    off = np.abs(found.depth - truths[2])[shown] / truths[2][shown]
    # A pixel of disparity is 2 %.
    assert np.median(off) < 0.002
    assert np.mean(off < 0.02) > 0.9


def test_only_object_pixels_are_searched() -> None:
    views, truths = make_posed_views(3)
    thing = np.zeros(truths[1].shape, bool)
    thing[60:90, 100:140] = True
    part = sweep_view(replace(views[1], object_mask=thing), [views[0], views[2]])
    assert part.depth[60:90, 100:140].all()
    assert not part.depth[:20].any()
    assert not part.distinctness[:20].any()


def test_depth_outside_the_mask_of_a_partner_is_rejected() -> None:
    """The mask of the partner leaves only the true depth, so even an untextured object is found."""
    views, _ = make_posed_views(2)
    flat = [replace(one, grey=np.full_like(one.grey, 90)) for one in views]
    matrix = views[0].view.compute_projection_to(views[1].view)
    v, u = np.mgrid[60:100, 90:130]
    places = np.stack([u, v, np.ones_like(u)], -1) @ matrix[:, :3].T + matrix[:, 3] / 1.5
    at = np.rint(places[..., :2] / places[..., 2:]).astype(int)
    thing = np.zeros(views[1].grey.shape, bool)
    thing[at[..., 1], at[..., 0]] = True
    found = sweep_view(flat[0], [replace(flat[1], object_mask=thing)])
    assert np.median(found.depth[75:85, 105:115]) == pytest.approx(1.5, rel=0.15)


def test_confidence_increases_with_evidence() -> None:
    rng = np.random.default_rng(3)
    grey = rng.integers(0, 256, (40, 60), dtype=np.uint8)
    depth = np.full((40, 60), 2.0, np.float32)
    depth[:, :5] = 0

    def at(distinct: int, agreeing: int, image: np.ndarray = grey, is_outlined: bool = False) -> np.ndarray:
        sure, same, all_ = (np.full((40, 60), n, np.uint8) for n in (distinct, agreeing, 8))
        return compute_sweep_confidence(depth, sure, image, ViewSupport(same, same, all_, all_), is_outlined)

    assert not at(128, 4)[:, :5].any()
    inner = np.s_[10:30, 20:40]
    assert (at(128, 6)[inner] > at(128, 2)[inner]).all()
    assert (at(200, 4)[inner] > at(60, 4)[inner]).all()
    flat = np.full_like(grey, 200)
    assert (at(128, 4)[inner] > at(128, 4, flat)[inner]).all()
    assert (at(128, 4, flat, is_outlined=True)[inner] > at(128, 4, flat)[inner]).all()


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_support_of_other_views_agrees_with_the_reference(seed: int) -> None:
    """The reference projects each point separately in NumPy."""
    rng = np.random.default_rng(seed)
    camera = replace(posed_scene.CAMERA, width=12, height=9, cx=5.5, cy=4.0, fx=10.0, fy=11.0)
    views = [
        PosedView(camera, posed_scene.pose(float(rng.uniform(-20, 20)), float(rng.uniform(-9, 9))), 0.5, 4.0)
        for _ in range(4)
    ]
    maps = [rng.choice([0, 1.0, 1.4, 1.5, 1.6, 2], (9, 12)).astype(np.float32) for _ in views]
    masks = [rng.random((9, 12)) < 0.7 for _ in views]
    matrices = [views[0].compute_projection_to(other) for other in views[1:]]

    near, wide, open_, looking = _kernels.count_supporting_views(
        maps[0],
        list(zip(matrices, maps[1:], strict=True)),
        tolerances=(0.05, 0.2),
        min_depth_ratio=0.9,
        wanted_threads=2,
    )
    inside = _kernels.is_inside_all_masks(
        maps[0], list(zip(matrices, masks[1:], strict=True)), wanted_threads=2
    )

    for v, u in np.ndindex(maps[0].shape):
        z = float(maps[0][v, u])
        point = views[0].to_world(views[0].compute_rays(np.array(float(u)), np.array(float(v))) * z)
        counts, is_inside, behind, seen = [0, 0], True, 0, 0
        for other, depth, mask in zip(views[1:], maps[1:], masks[1:], strict=True):
            x, y, ahead = (float(n) for n in other.project(point))
            if not other.contains(np.array(x), np.array(y)):
                continue
            column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
            is_inside &= bool(mask[row, column])
            behind += int(depth[row, column] > 0.9 * ahead)
            seen += int(depth[row, column] > 0)
            for k, tolerance in enumerate((0.05, 0.2)):
                counts[k] += depth[row, column] > 0 and abs(depth[row, column] - ahead) <= tolerance * ahead
        if z > 0:
            assert (near[v, u], wide[v, u]) == tuple(counts)
            assert inside[v, u] == is_inside
            assert (open_[v, u], looking[v, u]) == (behind, seen)
        else:
            assert near[v, u] == wide[v, u] == open_[v, u] == looking[v, u] == 0
