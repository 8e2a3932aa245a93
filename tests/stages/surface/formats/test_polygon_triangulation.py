"""Polygon triangulation: triangles cover a polygon once, keep its orientation, and use every corner."""

import numpy as np
import pytest

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.surface.formats.polygon_triangulation import triangulate_polygons


def triangulate(ring) -> tuple[np.ndarray, list[Diagnostic]]:
    points = np.array(ring, float)
    if points.shape[1] == 2:
        points = np.pad(points, ((0, 0), (0, 1)))
    with collecting() as diagnostics:
        corners, source = triangulate_polygons(np.array([len(ring)]), np.arange(len(ring)), points, "a.ply")
    assert (source == 0).all()
    return corners, diagnostics


def compute_signed_areas(ring, corners) -> np.ndarray:
    a, b, c = np.array(ring, float)[corners].transpose(1, 0, 2)
    ab, ac = b - a, c - a
    return (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) / 2


def make_star(count: int) -> list[tuple[float, float]]:
    angle = 2 * np.pi * np.arange(count) / count
    radius = 1 + 0.5 * np.cos(9 * angle)
    return list(zip(radius * np.cos(angle), radius * np.sin(angle), strict=True))


@pytest.mark.parametrize(
    ("ring", "area"),
    [
        ([(0, 0), (2, 0), (2, 2), (0, 2)], 4.0),
        # Concave at corner 3: the fan from corner 0 is valid for one order of the corners.
        ([(0, 0), (2, 0), (2, 2), (1.5, 0.5)], 1.0),
        ([(2, 0), (2, 2), (1.5, 0.5), (0, 0)], 1.0),
        ([(4, 0), (4, 4), (2, 1), (0, 4), (0, 0)], 10.0),
        # Corners on straight sides, including the first one.
        ([(1, 0), (2, 0), (2, 1), (2, 2), (0, 2), (0, 1), (0, 0)], 4.0),
        ([(0, 0), (1, 0), (2, 0), (2, 2), (1, 1), (0, 2)], 3.0),
        # A comb.
        ([(0, 0), (5, 0), (5, 3), (4, 1), (3, 3), (2, 1), (1, 3), (0, 1)], 10.0),
        (make_star(400), None),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_triangles_cover_the_polygon_once(ring, area, turned):
    ring = ring[::-1] if turned else ring
    corners, diagnostics = triangulate(ring)
    areas = compute_signed_areas(ring, corners)
    x, y = np.array(ring, float).T
    whole = 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    if area is not None:
        assert abs(whole) == pytest.approx(area)
    assert len(corners) == len(ring) - 2
    assert (areas * np.sign(whole) > 0).all()
    assert areas.sum() == pytest.approx(whole)
    # Each side of the polygon is a side of one triangle, in the same direction.
    sides = {(a, b) for t in corners.tolist() for a, b in zip(t, np.roll(t, -1).tolist(), strict=True)}
    assert {(k, (k + 1) % len(ring)) for k in range(len(ring))} <= sides
    assert [str(one) for one in diagnostics] == ["a.ply: 1 polygons were split into triangles"]
    assert diagnostics[0].severity == Severity.INFO


def test_polygons_in_any_plane_are_triangulated():
    rng = np.random.default_rng(0)
    flat = np.pad(np.array([(4.0, 0.0), (4, 4), (2, 1), (0, 4), (0, 0)]), ((0, 0), (0, 1)))
    for _ in range(20):
        turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
        corners, _ = triangulate(flat @ turn.T * 1e-4 + rng.normal(size=3) * 100)
        assert abs(compute_signed_areas(flat[:, :2], corners)).sum() == pytest.approx(10)


@pytest.mark.parametrize(
    "ring",
    [
        [(0, 0), (2, 2), (2, 0), (0, 2)],  # a bow tie
        [(0, 0), (1, 0), (2, 0), (3, 0)],
        [(0, 0), (0, 0), (0, 0), (0, 0), (0, 0)],
        [(np.cos(4 * np.pi * k / 5), np.sin(4 * np.pi * k / 5)) for k in range(5)],  # a pentagram
        [(0, 0), (np.nan, 0), (1, 1), (0, 1)],
    ],
)
def test_self_intersecting_and_flat_polygons_are_split_as_if_convex(ring):
    corners, diagnostics = triangulate(ring)
    assert corners.tolist() == [[0, k, k + 1] for k in range(1, len(ring) - 1)]
    assert diagnostics[1].message.startswith("1 polygons intersect themselves or have no area")
    assert diagnostics[1].severity == Severity.WARNING


def test_indices_out_of_range_are_kept():
    with collecting():
        corners, _ = triangulate_polygons(np.array([4]), np.array([0, 1, 7, 2]), np.eye(3), "mesh")
    assert len(corners) == 2
    # Next to a quad that is concave at corner 3.
    points = np.array([(0, 0, 0), (2, 0, 0), (2, 2, 0), (1.5, 0.5, 0)])
    with collecting():
        corners, _ = triangulate_polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 0, 1, 9]), points, "mesh")
    assert sorted(map(sorted, corners.tolist())) == [[0, 1, 3], [1, 2, 3], [4, 5, 6]]
