"""Proof of collision geometry: bounds hold at dense samples and are tight."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import Mesh
from scanloom.stages.exporting.simulation.collision_proof import measure_diagonal, prove_collision
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, build_part

Box = tuple[tuple[float, float, float], tuple[float, float, float]]


def make_box(low: object, high: object) -> ConvexPart:
    low, high = np.array(low, float), np.array(high, float)
    corners = np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1).reshape(-1, 3)
    return build_part(low + corners * (high - low))


def as_surface(part: ConvexPart, divisions: int = 0) -> Mesh:
    made = trimesh.Trimesh(part.vertices, part.triangles, process=False)
    for _ in range(divisions):
        made = made.subdivide()
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int32))


def measure_outside_box(points: np.ndarray, low: object, high: object) -> np.ndarray:
    return np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0), axis=1)


@st.composite
def boxes(draw: st.DrawFn) -> list[Box]:
    made = []
    for _ in range(draw(st.integers(1, 4))):
        low = [draw(st.floats(-0.3, 0.7)) for _ in range(3)]
        size = [draw(st.floats(0.05, 1.0)) for _ in range(3)]
        made.append((tuple(low), tuple(a + b for a, b in zip(low, size, strict=True))))
    return made


@settings(max_examples=10, deadline=None)
@given(made=boxes(), divisions=st.integers(0, 2))
def test_bounds_hold_at_dense_samples_and_are_tight(made: list[Box], divisions: int) -> None:
    low, high = np.zeros(3), np.array([1.0, 0.8, 0.6])
    surface = as_surface(make_box(low, high), divisions)
    parts = [make_box(*one) for one in made]
    proof = prove_collision(surface, parts, is_solid=True)
    rng = np.random.default_rng(0)
    # Excess: points of the parts, including their corners.
    inside = np.concatenate([rng.uniform(*one, (5_000, 3)) for one in made] + [p.vertices for p in parts])
    excess = measure_outside_box(inside, low, high).max()
    # Gap: points of the surface, including its corners.
    sampled, _ = trimesh.sample.sample_surface(
        trimesh.Trimesh(surface.vertices, surface.triangles), 10_000, seed=0
    )
    on_surface = np.concatenate([sampled, surface.vertices])
    gap = np.min([measure_outside_box(on_surface, *map(np.array, one)) for one in made], axis=0).max()
    tolerance = 0.01 * measure_diagonal(surface.vertices)
    assert excess <= proof.excess_m <= 1.5 * excess + tolerance
    assert gap <= proof.gap_m + 1e-12
    assert proof.gap_m <= 1.5 * gap + tolerance
    assert proof.attained_excess_m <= proof.excess_m
    assert proof.attained_gap_m <= proof.gap_m


def test_the_excess_inside_an_enclosed_cavity_is_found() -> None:
    # The corners of the part are on the outer surface; only points in its interior are outside the solid.
    outer, inner = make_box([0, 0, 0], [1, 1, 1]), make_box([0.25] * 3, [0.75] * 3)
    surface = Mesh(
        np.concatenate((outer.vertices, inner.vertices)),
        np.concatenate((outer.triangles, inner.triangles[:, ::-1] + len(outer.vertices))),
    )
    proof = prove_collision(surface, [outer], is_solid=True)
    assert 0.25 <= proof.excess_m < 0.27
    assert proof.gap_m == 0


def test_a_surface_that_intersects_itself_encloses_the_union() -> None:
    first, second = make_box([0, 0, 0], [1, 1, 1]), make_box([0.4, 0.4, 0.4], [1.4, 1.4, 1.4])
    surface = Mesh(
        np.concatenate((first.vertices, second.vertices)),
        np.concatenate((first.triangles, second.triangles + len(first.vertices))),
    )
    proof = prove_collision(surface, [first, second], is_solid=True)
    assert proof.gap_m == 0
    assert proof.excess_m < 0.01 * measure_diagonal(surface.vertices)
    assert proof.attained_excess_m < 1e-6


def test_parts_of_an_open_surface_are_bounded_on_both_sides() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float)
    surface = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32))
    proof = prove_collision(surface, [make_box([0, 0, -0.1], [1, 1, 0.05])], is_solid=False)
    assert 0.1 <= proof.excess_m <= 0.106


@pytest.mark.parametrize("shift", [0.0, 1000.0])
def test_touching_parts_leave_no_gap(shift: float) -> None:
    surface = as_surface(make_box([shift] * 3, [shift + 1] * 3))
    # Overlap, so that each small piece is inside one part.
    halves = [
        make_box([shift, shift, shift], [shift + 0.51, shift + 1, shift + 1]),
        make_box([shift + 0.49, shift, shift], [shift + 1, shift + 1, shift + 1]),
    ]
    assert prove_collision(surface, halves, is_solid=True).gap_m == 0
