"""Irregular elements agree with their definitions, computed element by element."""

from __future__ import annotations

import itertools
import math
from collections import defaultdict

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from scanloom.stages._kernels import find_intersecting_triangles
from scanloom.stages.cleaning.regularity import NO_INTERSECTION, AngleLimits, find_local_irregular
from scanloom.stages.progress import ignore_progress
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import topology

LIMITS = AngleLimits(corner_deg=20.0, fold_deg=60.0, spike_deg=150.0)
Floats = NDArray[np.float64]
Corners = tuple[int, ...]


def make_soup(seed: int) -> tuple[Floats, NDArray[np.int32]]:
    """Make triangles of few vertices, so that edges are shared by any number of triangles."""
    random = np.random.default_rng(seed)
    vertices = random.normal(size=(random.integers(3, 10), 3))
    return vertices, random.integers(0, len(vertices), (random.integers(0, 25), 3)).astype(np.int32)


def make_folded_ball(seed: int) -> tuple[Floats, NDArray[np.int32]]:
    """Make a closed surface with noise that folds it, some triangles turned over, and some removed."""
    mesh, random = trimesh.creation.icosphere(subdivisions=3), np.random.default_rng(seed)
    triangles = np.array(mesh.faces, np.int32)
    turned = random.integers(0, len(triangles), 10)
    triangles[turned] = triangles[turned][:, ::-1]
    kept = np.sort(random.permutation(len(triangles))[10:])
    return mesh.vertices + random.normal(scale=0.06, size=mesh.vertices.shape), triangles[kept]


def compute_angle(one: Floats, other: Floats) -> float:
    return math.degrees(math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other)))


def find_by_definition(vertices: Floats, triangles: NDArray[np.int32]) -> dict[str, list[object]]:
    rows = [tuple(int(v) for v in row) for row in triangles]
    proper = {t: row for t, row in enumerate(rows) if len(set(row)) == 3}
    around: dict[Corners, list[int]] = defaultdict(list)
    for t, (a, b, c) in proper.items():
        for side in ((a, b), (b, c), (c, a)):
            around[tuple(sorted(side))].append(t)
    edges = dict(sorted(around.items()))

    def runs_forward(t: int, edge: Corners) -> bool:
        return edge in list(itertools.pairwise([*proper[t], proper[t][0]]))

    inconsistent = [
        e for e, ts in edges.items() if len(ts) == 2 and len({runs_forward(t, e) for t in ts}) == 1
    ]
    singular = [v for v in range(len(vertices)) if count_fans(v, proper, edges) > 1]
    borders = [e for e, ts in edges.items() if len(ts) == 1]
    ends = [v for edge in borders for v in edge]
    neighbours = {v: sum(v in edge for edge in edges) for v in singular}
    lone = [v for v in singular if 2 * sum(v in row for row in proper.values()) == neighbours[v]]
    normals = [np.cross(vertices[b] - vertices[a], vertices[c] - vertices[a]) for a, b, c in rows]
    angles = [
        [
            compute_angle(vertices[row[k - 2]] - vertices[row[k]], vertices[row[k - 1]] - vertices[row[k]])
            for k in range(3)
        ]
        for row in rows
    ]
    degenerate = [t for t in range(len(rows)) if t not in proper or np.linalg.norm(normals[t]) < 1e-12]
    sound = [t for t in proper if t not in degenerate]
    caps = [t for t in sound if max(angles[t]) > 180 - LIMITS.corner_deg]
    sums = [
        sum(angles[t][row.index(v)] for t, row in proper.items() if v in row) for v in range(len(vertices))
    ]
    irregular = {v for edge, ts in edges.items() if len(ts) != 2 for v in edge} | set(singular)
    used = {v for row in proper.values() for v in row}
    return {
        "border_edges": list(borders),
        "nonmanifold_edges": [e for e, ts in edges.items() if len(ts) > 2],
        "inconsistent_edges": list(inconsistent),
        "singular_vertices": list(singular),
        "focal_vertices": [v for v in range(len(vertices)) if ends.count(v) > 2],
        "singular_border_triangles": [t for t, row in proper.items() if set(row) & set(lone)],
        "degenerate_triangles": list(degenerate),
        "duplicate_triangles": [
            t for t, row in proper.items() if any(set(proper[s]) == set(row) for s in proper if s < t)
        ],
        "caps": list(caps),
        "needles": [t for t in sound if t not in caps and min(angles[t]) < LIMITS.corner_deg],
        "sharp_edges": [
            e
            for e, ts in edges.items()
            if len(ts) == 2
            and not set(ts) & set(degenerate)
            and compute_angle(normals[ts[0]], normals[ts[1]] * (-1 if e in inconsistent else 1))
            > 180 - LIMITS.fold_deg
        ],
        "spikes": [v for v in used if v not in irregular and sums[v] < LIMITS.spike_deg],
    }


def count_fans(vertex: int, proper: dict[int, Corners], edges: dict[Corners, list[int]]) -> int:
    left = {t for t, row in proper.items() if vertex in row}
    count = 0
    while left:
        front, count = [left.pop()], count + 1
        while front:
            t = front.pop()
            sides = [tuple(sorted((vertex, v))) for v in proper[t] if v != vertex]
            found = {other for side in sides for other in edges[side]} & left
            left -= found
            front += found
    return count


@pytest.mark.parametrize("make", [make_soup, make_folded_ball])
def test_irregular_elements_agree_with_their_definitions(make) -> None:
    seen: dict[str, int] = defaultdict(int)
    for seed in range(60 if make is make_soup else 4):
        vertices, triangles = make(seed)
        found = find_local_irregular(vertices, triangles, LIMITS)
        for name, expected in find_by_definition(vertices, triangles).items():
            rows = [tuple(row) if np.ndim(row) else row for row in found[name].tolist()]
            assert rows == expected, (name, seed)
            seen[name] += len(rows)
    assert min(seen[name] for name in ("border_edges", "inconsistent_edges", "needles", "sharp_edges")) > 0
    if make is make_soup:
        assert min(seen[name] for name in ("duplicate_triangles", "singular_vertices", "focal_vertices")) > 0


def test_a_spike_and_its_loops_are_found() -> None:
    # A slim pyramid on a square sheet: its tip is a spike, and the border of the sheet is one loop.
    corners = [(-9, -9, 0), (9, -9, 0), (9, 9, 0), (-9, 9, 0), (-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
    vertices = np.array([*corners, (0, 0, 20)], float)
    ring = [(i, (i + 1) % 4, 4 + (i + 1) % 4) for i in range(4)]
    ring += [(i, 4 + (i + 1) % 4, 4 + i) for i in range(4)]
    triangles = np.array([*ring, *((4 + i, 4 + (i + 1) % 4, 8) for i in range(4))], np.int32)
    found = find_local_irregular(vertices, triangles, AngleLimits(corner_deg=1, fold_deg=10, spike_deg=60))
    assert found["spikes"].tolist() == [8]
    counted = topology(Mesh(vertices, triangles))
    assert (counted.boundary_loops, counted.components, counted.euler) == (1, 1, 1)


@pytest.mark.parametrize("seed", range(5))
def test_triangles_that_only_intersect_earlier_ones_are_found(seed: int) -> None:
    random = np.random.default_rng(seed)
    centers = random.random((300, 1, 3))
    vertices = (centers + random.normal(scale=0.05, size=(300, 3, 3))).reshape(-1, 3)
    triangles = np.arange(900, dtype=np.int32).reshape(-1, 3)
    other = find_intersecting_triangles(vertices, triangles, wanted_threads=2, progress=ignore_progress)
    meets = other != NO_INTERSECTION
    pairs = {(int(t), int(other[t])) for t in np.flatnonzero(meets)}
    alone = [
        find_intersecting_triangles(vertices, triangles[[t, s]], wanted_threads=1, progress=ignore_progress)[
            0
        ]
        != NO_INTERSECTION
        for t, s in pairs
    ]
    assert all(alone)
    assert 0 < np.count_nonzero(meets) < 300
    # Whether a triangle intersects another one does not depend on their order.
    again = find_intersecting_triangles(
        vertices, triangles[::-1].copy(), wanted_threads=1, progress=ignore_progress
    )
    np.testing.assert_array_equal((again != NO_INTERSECTION)[::-1], meets)
