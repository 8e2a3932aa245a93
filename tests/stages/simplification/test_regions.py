"""Regions: their vertices, their text form, and invalid regions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.regions import Box, Region, Sphere, parse_region, resolve_vertex_control
from scanloom.stages.surface.mesh import Mesh

LINE = Mesh(np.stack([np.arange(5.0), np.zeros(5), np.zeros(5)], 1), np.zeros((0, 3), np.int32))


def test_a_sphere_contains_points_within_its_radius() -> None:
    sphere = Sphere((1.0, 0.0, 0.0), 1.0, lock=True)
    assert sphere.contains(LINE.vertices).tolist() == [True, True, True, False, False]


def test_a_box_contains_points_between_its_corners() -> None:
    box = Box((0.5, -1.0, 0.0), (3.0, 1.0, 0.0), lock=True)
    assert box.contains(LINE.vertices).tolist() == [False, True, True, True, False]


@pytest.mark.parametrize(
    ("text", "region"),
    [
        ("sphere 1 -2 3e0 0.5 20", Sphere((1, -2, 3), 0.5, importance=20)),
        ("sphere 1,-2,3,0.5,lock", Sphere((1, -2, 3), 0.5, lock=True)),
        ("box -1 -1 -1 1 1 1 lock", Box((-1, -1, -1), (1, 1, 1), lock=True)),
        ("  box -1 -1 -1 1 1 1 0.25 lock", Box((-1, -1, -1), (1, 1, 1), importance=0.25, lock=True)),
    ],
)
def test_regions_are_parsed_from_text(text: str, region: Region) -> None:
    assert parse_region(text) == region


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "starts with neither sphere nor box"),
        ("ball 0 0 0 1 lock", 'starts with neither sphere nor box; write "sphere x y z radius'),
        ("sphere 0 0 0 lock", "a sphere has 4 numbers and at most one importance, not 3"),
        ("box 0 0 0 1 1 1 5 5", "a box has 6 numbers and at most one importance, not 8"),
        ("sphere 0 0 0 one lock", "could not convert string to float: 'one'"),
        ("sphere 0 0 0 lock 1", "'lock'"),
        ("sphere 0 0 0 1", "has no effect; give it an importance, or lock it"),
        ("sphere 0 0 0 0 lock", "the radius must be above 0"),
        ("sphere 0 0 nan 1 lock", "three finite numbers"),
        ("sphere 0 0 0 1 0", "an importance must be above 0"),
        ("sphere 0 0 0 1 inf", "an importance must be above 0 and finite"),
        ("box 0 0 0 1 -1 1 lock", "the first corner must be the minimum"),
    ],
)
def test_invalid_regions_are_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_region(text)


def test_a_center_needs_three_coordinates() -> None:
    with pytest.raises(UsageError, match="three finite numbers"):
        Sphere((0, 0), 1, lock=True)  # type: ignore[arg-type]


def test_the_largest_importance_counts_and_locks_add_up() -> None:
    regions = (
        Sphere((0.0, 0.0, 0.0), 1.5, importance=0.5),
        Sphere((1.0, 0.0, 0.0), 1.5, importance=4.0, lock=True),
    )
    lock, importance = resolve_vertex_control(LINE, [4], None, regions)
    assert lock.tolist() == [True, True, True, False, True]
    assert importance.tolist() == [4, 4, 4, 1, 1]
    _, importance = resolve_vertex_control(LINE, None, [0.1, 9, 1, 2, 3], regions)
    assert importance.tolist() == [4, 9, 4, 2, 3]


def test_a_region_can_reduce_the_importance() -> None:
    _, importance = resolve_vertex_control(LINE, None, None, [Sphere((0.0, 0.0, 0.0), 1.5, importance=0.5)])
    assert importance.tolist() == [0.5, 0.5, 1, 1, 1]


coordinate = st.floats(-1e6, 1e6)


@given(
    center=st.tuples(coordinate, coordinate, coordinate),
    radius=st.floats(1e-6, 1e6),
    effect=st.fixed_dictionaries({"importance": st.floats(1e-6, 1e6), "lock": st.booleans()}),
)
def test_a_region_is_read_as_written(
    center: tuple[float, float, float], radius: float, effect: dict[str, Any]
) -> None:
    words = ["sphere", *map(repr, center), repr(radius), repr(effect["importance"])]
    words += ["lock"] * effect["lock"]
    assert parse_region(" ".join(words)) == Sphere(center, radius, **effect)
