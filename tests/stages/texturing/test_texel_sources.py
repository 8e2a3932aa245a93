"""Kernels that find and sample the sources of texels, compared with NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from coloured_meshes import ball
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.raycasting import (
    RaycastingSurface,
    compute_closest_weights,
    compute_triangle_normals,
)
from scanloom.stages.surface.surface_color import sample_bilinear

WRAPS = ("repeat", "clamp", "mirror")


def make_noise(height: int, width: int, channels: int, seed: int = 0) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (height, width, channels), np.uint8)


def make_triangles(count: int, size: float, seed: int) -> NDArray[np.float64]:
    """Make triangles of all sizes in a square; some are outside, tiny, thin or without area."""
    rng = np.random.default_rng(seed)
    middles = rng.uniform(-0.1 * size, 1.1 * size, (count, 1, 2))
    sizes = rng.choice([0.1, 3, 20], (count, 1, 1))
    corners: NDArray[np.float64] = middles + rng.normal(size=(count, 3, 2)) * sizes
    corners[::7, 2] = corners[::7, 1]
    corners[1::7, 2] = (corners[1::7, 0] + corners[1::7, 1]) / 2
    return corners


def compute_weights(corners: NDArray[np.float64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute barycentric weights (k, 3) of points (k, 2) in one triangle."""
    a, ab, ac = corners[0], corners[1] - corners[0], corners[2] - corners[0]
    p = points - a
    area = ab[0] * ac[1] - ab[1] * ac[0]
    if abs(area) < 1e-9:
        return np.full((len(points), 3), -1.0)
    v, w = (p[:, 0] * ac[1] - p[:, 1] * ac[0]) / area, (ab[0] * p[:, 1] - ab[1] * p[:, 0]) / area
    return np.stack([1 - v - w, v, w], axis=1)


def list_centres(width: int, height: int) -> NDArray[np.float64]:
    rows, columns = np.mgrid[:height, :width]
    return np.stack([columns + 0.5, rows + 0.5], axis=-1).reshape(-1, 2)


def make_inputs(seed: int = 0, count: int = 300, size: int = 150) -> dict[str, Any]:
    """Make a simplified mesh of two charts, and random triangles of the original."""
    half = size / 2
    boxes = [(0.0, 0.0, half - 4, size), (half + 4, 0.0, size, size)]
    own = np.array(
        [corners for x, y, u, v in boxes for corners in ([(x, y), (u, y), (u, v)], [(x, y), (u, v), (x, v)])]
    )
    corners = make_triangles(count, size, seed)
    charts = np.random.default_rng(seed).integers(0, 2, count, np.int32)
    flat = [np.concatenate([c, np.zeros((len(c), 3, 1))], axis=2) for c in (own, corners)]
    return {
        "simplified": (own, np.array([0, 0, 1, 1], np.int32), flat[0]),
        "original": (corners, charts, flat[1]),
        "max_distances": np.full(count, np.inf),
        "width": size,
        "height": size,
    }


def draw_sources(case: dict[str, Any], threads: int = 1) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    case = dict(case)
    given = [case.pop(name) for name in ("simplified", "original", "max_distances")]
    return _kernels.draw_sources(*given, wanted_threads=threads, **case)


@pytest.mark.slow
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_the_last_triangle_of_a_chart_is_drawn(seed: int) -> None:
    case = make_inputs(seed)
    corners, charts, _ = case["original"]
    simplified, found = draw_sources(case)
    own_charts = np.where(simplified >= 0, simplified // 2, -1).ravel()
    points = list_centres(150, 150)
    expected, is_sure = np.full(len(points), -1), np.ones(len(points), bool)
    for index, triangle in enumerate(corners):
        weights = compute_weights(triangle, points)
        is_here = own_charts == charts[index]
        expected[is_here & (weights > 1e-9).all(axis=1)] = index
        # On an edge, rounding decides.
        is_sure &= ~(is_here & (np.abs(weights.min(axis=1)) <= 1e-9))
    is_inside = (expected >= 0) & is_sure
    assert np.array_equal(found.ravel()[is_inside], expected[is_inside])
    # Outside triangles, the kernel only draws triangles that are close.
    beside = np.flatnonzero((expected < 0) & (found.ravel() >= 0))
    flat = np.concatenate([corners, np.zeros((len(corners), 3, 1))], axis=2)[found.ravel()[beside]]
    at = np.concatenate([points[beside], np.zeros((len(beside), 1))], axis=1)
    nearest = np.einsum("kc,kcx->kx", compute_closest_weights(at, flat), flat)
    assert np.linalg.norm(nearest - at, axis=1).max(initial=0) < 3
    assert np.array_equal(charts[found.ravel()[beside]], own_charts[beside])


def test_charts_include_the_reach_of_bilinear_samples() -> None:
    case = make_inputs()
    simplified, _ = draw_sources(case)
    # Pixel centres at x = 71 and x = 79 are the last of the charts.
    assert (simplified[:, :72] >= 0).all()
    assert (simplified[:, 73:77] < 0).all()
    assert (simplified[:, 78:] >= 0).all()


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_results_do_not_depend_on_the_number_of_threads(threads: int) -> None:
    case = make_inputs(3, 2000, 300)
    one, several = draw_sources(case, 1), draw_sources(case, threads)
    for first, second in zip(one, several, strict=True):
        assert np.array_equal(first, second)
    uvs = np.random.default_rng(1).uniform(-2, 3, (2000, 3, 2))
    canvases = []
    for count in (1, threads):
        canvas = np.zeros((300, 300, 3), np.uint8)
        _kernels.sample_texels(
            canvas,
            one[1],
            case["original"][0],
            uvs,
            np.ones(2000, bool),
            make_noise(64, 64, 3),
            wrap=("repeat", "mirror"),
            wanted_threads=count,
        )
        canvases.append(canvas)
    assert np.array_equal(canvases[0], canvases[1])


def test_far_points_are_not_drawn() -> None:
    case = make_inputs(5)
    _, near = draw_sources(case | {"max_distances": np.full(300, 1e-6)})
    assert np.array_equal(draw_sources(case)[1][near >= 0], near[near >= 0])
    corners, charts, positions = case["original"]
    moved = (corners, charts, positions + np.array([0, 0, 2.0]))
    assert (draw_sources(case | {"original": moved, "max_distances": np.full(300, 1.9)})[1] < 0).all()
    limits = np.where(np.arange(300) % 2 == 0, 1.9, np.inf)
    _, found = draw_sources(case | {"original": moved, "max_distances": limits})
    assert (found >= 0).any()
    assert (found[found >= 0] % 2 == 1).all()


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    size=st.tuples(st.integers(1, 9), st.integers(1, 9)),
    wrap=st.tuples(st.sampled_from(WRAPS), st.sampled_from(WRAPS)),
    reach=st.sampled_from([0.5, 3.0, 1e3]),
)
def test_samples_agree_with_sample_bilinear(
    seed: int, size: tuple[int, int], wrap: tuple[str, str], reach: float
) -> None:
    image = make_noise(*size, 4, seed)
    uvs = np.random.default_rng(seed).uniform(0.5 - reach, 0.5 + reach, (500, 2))
    uvs[:20] = np.round(uvs[:20])
    found = _kernels.sample_points(image, uvs, channels=3, wrap=wrap, wanted_threads=2)
    # Interpolation weights have eight bits.
    assert np.abs(found - sample_bilinear(image, uvs, wrap)).max() <= 2.5
    assert np.array_equal(
        found, _kernels.sample_points(image, uvs, channels=4, wrap=wrap, wanted_threads=1)[:, :3]
    )


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_texels_get_the_samples_of_their_triangles(channels: int) -> None:
    case = make_inputs(8)
    corners = case["original"][0]
    _, triangles = draw_sources(case)
    uvs = np.random.default_rng(2).uniform(0, 1, (300, 3, 2))
    image = make_noise(40, 30, channels)
    is_shown = np.arange(300) % 3 > 0
    canvas = np.full((150, 150, channels), 77, np.uint8)
    _kernels.sample_texels(
        canvas, triangles, corners, uvs, is_shown, image, wrap=("clamp", "clamp"), wanted_threads=1
    )
    texels = np.flatnonzero((triangles.ravel() >= 0) & is_shown[triangles.ravel()])
    weights = _kernels.locate_texels(corners, triangles.ravel()[texels], texels, width=150, wanted_threads=2)
    at = np.einsum("kc,kcx->kx", weights.astype(float), uvs[triangles.ravel()[texels]])
    expected = np.full((150 * 150, channels), 77, np.uint8)
    expected[texels] = _kernels.sample_points(
        image, at, channels=channels, wrap=("clamp", "clamp"), wanted_threads=1
    )
    difference = np.abs(canvas.reshape(-1, channels).astype(int) - expected)
    # Weights are in single precision.
    assert difference.max() <= 2
    assert (difference[triangles.ravel() < 0] == 0).all()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 1000))
def test_texels_are_located_at_the_nearest_point(seed: int) -> None:
    corners = make_triangles(100, 40, seed)
    rng = np.random.default_rng(seed)
    triangles, texels = rng.integers(0, 100, 500).astype(np.int32), rng.integers(0, 1600, 500)
    found = _kernels.locate_texels(corners, triangles, texels, width=40, wanted_threads=1)
    flat = np.concatenate([corners, np.zeros((100, 3, 1))], axis=2)[triangles]
    at = np.concatenate([list_centres(40, 40)[texels], np.zeros((500, 1))], axis=1)
    away = [
        np.linalg.norm(np.einsum("kc,kcx->kx", weights, flat) - at, axis=1)
        for weights in (found, compute_closest_weights(at, flat))
    ]
    assert np.abs(away[0] - away[1]).max() < 1e-4
    assert (found >= 0).all()
    assert np.allclose(found.sum(axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("threads", [1, 3])
def test_the_nearest_points_of_a_surface_are_found(threads: int) -> None:
    mesh = ball()
    surface = _kernels.NearestSurface(mesh.vertices, mesh.triangles, wanted_threads=threads)
    points = np.random.default_rng(0).normal(size=(3000, 3))
    triangles, weights, distances = surface.find_nearest(points, wanted_threads=threads)
    expected = RaycastingSurface(
        mesh, np.array([points.min(axis=0), points.max(axis=0)])
    ).find_closest_points(points)
    assert np.allclose(distances, expected.distances, atol=1e-9)
    at = np.einsum("kc,kcx->kx", weights, mesh.vertices[mesh.triangles[triangles]])
    assert np.allclose(np.linalg.norm(points - at, axis=1), distances)
    # Normals inside the ball point outward, outside inward: the closest side of the ball, or the opposite
    # one.
    normals = points / np.linalg.norm(points, axis=1)[:, None]
    for sign in (1, -1):
        found, _, is_turned = surface.find_nearest_facing(
            points, sign * normals, reach=1e9, wanted_threads=threads
        )
        towards = np.einsum("kx,kx->k", compute_triangle_normals(mesh)[found], sign * normals)
        assert (towards > 0).all()
        assert is_turned.all() == (sign < 0)
    _, _, is_turned = surface.find_nearest_facing(points, -normals, reach=1e-3, wanted_threads=threads)
    assert not is_turned.any()


def test_invalid_queries_of_a_surface_are_refused() -> None:
    mesh = ball()
    surface = _kernels.NearestSurface(mesh.vertices, mesh.triangles, wanted_threads=1)
    nowhere = np.full((1, 3), np.nan)
    with pytest.raises(ValueError, match="not finite"):
        surface.find_nearest(nowhere, wanted_threads=1)
    with pytest.raises(ValueError, match="not finite"):
        surface.find_nearest_facing(nowhere, nowhere, reach=1.0, wanted_threads=1)
    with pytest.raises(ValueError, match="each point"):
        surface.find_nearest_facing(np.zeros((2, 3)), np.zeros((1, 3)), reach=1.0, wanted_threads=1)
    with pytest.raises(ValueError, match="needs a triangle"):
        _kernels.NearestSurface(mesh.vertices, mesh.triangles[:0], wanted_threads=1)
    with pytest.raises(ValueError, match="vertex"):
        _kernels.NearestSurface(mesh.vertices[:3], mesh.triangles, wanted_threads=1)
    with pytest.raises(ValueError, match="not finite"):
        _kernels.NearestSurface(mesh.vertices * np.nan, mesh.triangles, wanted_threads=1)


def change_array(case: dict[str, Any], name: str, place: int, value: Any) -> dict[str, Any]:
    arrays = list(case[name])
    arrays[place] = value
    return case | {name: tuple(arrays)}


def test_invalid_arguments_of_draw_sources_are_refused() -> None:
    case = make_inputs()
    _, charts, positions = case["original"]
    for bad in (np.nan, np.inf):
        for name in ("simplified", "original"):
            for place in (0, 2):
                spoilt = case[name][place].copy()
                spoilt[1, 1, 1] = bad
                with pytest.raises(ValueError, match="not finite"):
                    draw_sources(change_array(case, name, place, spoilt))
    with pytest.raises(ValueError, match="each triangle"):
        draw_sources(change_array(case, "original", 1, charts[:-1]))
    with pytest.raises(ValueError, match="each triangle"):
        draw_sources(change_array(case, "original", 2, positions[:-1]))
    with pytest.raises(ValueError, match="each triangle"):
        draw_sources(case | {"max_distances": np.ones(2)})
    with pytest.raises(ValueError, match="m × 3 × 2"):
        draw_sources(change_array(case, "original", 0, positions))
    for size in ({"width": 0}, {"height": 0}, {"width": 1 << 20, "height": 1 << 20}):
        with pytest.raises(ValueError, match="empty or too large"):
            draw_sources(case | size)
    simplified, found = draw_sources(case | {"max_distances": np.full(300, np.nan)})
    assert (simplified >= 0).any()
    assert (found < 300).all()
    nothing = (np.zeros((0, 3, 2)), np.zeros(0, np.int32), np.zeros((0, 3, 3)))
    empty = case | {"simplified": nothing, "original": nothing, "max_distances": np.zeros(0)}
    assert all((image == -1).all() for image in draw_sources(empty))


def test_invalid_arguments_of_sampling_are_refused() -> None:
    triangles = np.zeros((8, 9), np.int32)
    one = np.zeros((1, 3, 2))
    arguments: dict[str, Any] = {
        "atlas": np.zeros((8, 9, 3), np.uint8),
        "triangles": triangles,
        "corners": one,
        "uvs": one,
        "uses_image": np.ones(1, bool),
        "image": make_noise(4, 4, 3),
        "wrap": ("clamp", "clamp"),
        "wanted_threads": 1,
    }
    _kernels.sample_texels(**arguments)
    for changes in (
        {"atlas": np.zeros((8, 9, 4), np.uint8)},
        {"atlas": np.zeros((9, 8, 3), np.uint8)},
        {"atlas": np.zeros((8, 9, 0), np.uint8)},
        {"triangles": triangles + 1},
        {"corners": np.full((1, 3, 2), np.nan)},
        {"uvs": np.full((1, 3, 2), np.inf)},
        {"uvs": np.zeros((2, 3, 2))},
        {"uses_image": np.ones(2, bool)},
        {"image": np.zeros((0, 4, 3), np.uint8)},
        {"image": np.zeros((4, 4, 2), np.uint8)},
        {"wrap": ("clamp", "border")},
    ):
        with pytest.raises(ValueError, match=r"."):
            _kernels.sample_texels(**(arguments | changes))
    image = make_noise(4, 4, 3)
    for uvs, channels in (
        (np.zeros((2, 3)), 3),
        (np.full((2, 2), np.nan), 3),
        (np.zeros((2, 2)), 4),
        (np.zeros((2, 2)), 0),
    ):
        with pytest.raises(ValueError, match=r"."):
            _kernels.sample_points(image, uvs, channels=channels, wrap=("clamp", "clamp"), wanted_threads=1)
    for bad in (np.array([1], np.int32), np.array([-1], np.int32)):
        with pytest.raises(ValueError, match=r"."):
            _kernels.locate_texels(one, bad, np.zeros(1, np.int64), width=4, wanted_threads=1)
    with pytest.raises(ValueError, match=r"."):
        _kernels.locate_texels(one, np.zeros(1, np.int32), np.zeros(1, np.int64), width=0, wanted_threads=1)
