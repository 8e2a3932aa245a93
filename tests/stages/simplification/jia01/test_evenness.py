"""Evenness of edge lengths, the second claim of the paper, at no larger error."""

from __future__ import annotations

from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom import Mesh, compare, simplify

UNLIMITED = {"resolution": 100.0}


def make_uneven_sheet(seed: int, side: int = 40) -> Mesh:
    """Make a bumpy sheet with dense vertices at one corner, and vertices off their grid."""
    rng = np.random.default_rng(seed)
    at = np.linspace(0, 1, side + 1) ** rng.uniform(1.0, 1.6)
    x, y = np.meshgrid(at, at)
    inside = (x > 0) & (x < 1) & (y > 0) & (y < 1)
    spacing = np.gradient(at)
    x = x + inside * spacing * rng.uniform(-0.35, 0.35, x.shape)
    y = y + inside * spacing[:, None] * rng.uniform(-0.35, 0.35, x.shape)
    phase = rng.uniform(0, 6, 4)
    z = 0.05 * np.sin(5 * x + phase[0]) * np.cos(4 * y + phase[1]) + 0.02 * np.sin(9 * x * y + phase[2])
    corner = (np.arange(side)[:, None] * (side + 1) + np.arange(side)).ravel()
    triangles = np.concatenate(
        [
            np.stack([corner, corner + 1, corner + side + 2], axis=1),
            np.stack([corner, corner + side + 2, corner + side + 1], axis=1),
        ]
    )
    vertices = np.stack([x, y, z], axis=2).reshape(-1, 3)
    colors = np.rint(128 + 100 * np.sin(6 * vertices + phase[3])).astype(np.uint8)
    return Mesh(vertices, triangles.astype(np.int32), colors=colors)


def compute_variation(mesh: Mesh) -> float:
    """Compute the standard deviation of edge lengths, relative to their mean."""
    edges = np.unique(np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    lengths = np.linalg.norm(np.subtract(*mesh.vertices[edges.T]), axis=1)
    return float(lengths.std() / lengths.mean())


def measure_distance(mesh: Mesh, simplified: Mesh) -> float:
    """Measure the RMS of the two-sided distance, metres."""
    return compare(mesh, simplified, samples=20_000).symmetric.rms


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_splits_make_edges_more_even(seed: int) -> None:
    mesh = make_uneven_sheet(seed)
    even = simplify(mesh, method="jia01")
    limits = even.details
    assert limits.splits > 0
    assert limits.bounded["resolution"]
    bounds: dict[str, Any] = {"max_shape": limits.max_shape_m, "max_color": limits.max_color_levels}
    count = len(even.mesh.triangles)
    uneven = simplify(mesh, method="jia01", triangles=count, jia01=UNLIMITED, **bounds)
    # The other run may stop earlier at the same bounds.
    assert len(uneven.mesh.triangles) >= count - 1
    assert compute_variation(even.mesh) <= 0.9 * compute_variation(uneven.mesh)
    assert measure_distance(mesh, even.mesh) <= 1.1 * measure_distance(mesh, uneven.mesh)


@settings(max_examples=6, deadline=None)
@given(seed=st.integers(0, 2**31), ratio=st.sampled_from([0.5, 0.2, 0.05]))
def test_edges_are_more_even_at_a_given_count(seed: int, ratio: float) -> None:
    mesh = make_uneven_sheet(seed)
    even = simplify(mesh, method="jia01", ratio=ratio)
    uneven = simplify(mesh, method="jia01", ratio=ratio, jia01=UNLIMITED)
    assert even.stopped_by == "triangles"
    assert not even.details.bounded["resolution"]
    assert abs(len(even.mesh.triangles) - len(uneven.mesh.triangles)) <= 1
    assert compute_variation(even.mesh) <= 0.85 * compute_variation(uneven.mesh)
    assert measure_distance(mesh, even.mesh) <= measure_distance(mesh, uneven.mesh)


def test_a_flat_surface_needs_few_triangles() -> None:
    """The resolution grows with the area that a few triangles can cover."""
    side = np.linspace(0, 1, 41)
    x, y = np.meshgrid(side, side)
    mesh = make_uneven_sheet(1)
    flat = Mesh(np.stack([x, y, 0 * x], axis=2).reshape(-1, 3), mesh.triangles)
    assert len(simplify(flat, method="jia01").mesh.triangles) < 0.05 * len(flat.triangles)
