"""Importance in all rounds of method seams, and bounding box of the vertices."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from seamed_meshes import touching_parts, wrapped_ball

from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh


@functools.cache
def make_dense_ball() -> Mesh:
    """Make a ball of 19,800 triangles with a seam from pole to pole."""
    return wrapped_ball(rings=100, sectors=100, bumps=0.1)


def test_importance_counts_in_all_rounds() -> None:
    """Triangles had the importance of other triangles from the second round on."""
    mesh = make_dense_ball()
    upper = mesh.vertices[:, 2] > 0

    def share_above(importance: np.ndarray | None = None) -> float:
        light = simplify(mesh, method="seams", ratio=0.02, importance=importance).mesh
        return float((light.vertices[light.triangles].mean(axis=1)[:, 2] > 0).mean())

    assert share_above(np.where(upper, 100.0, 1.0)) > 1.4 * share_above()


@pytest.mark.parametrize("fit", [False, True])
def test_no_vertex_leaves_the_box_of_the_input(fit: bool) -> None:
    """One vertex replaced half a box, and its least-squares position was far outside."""
    mesh = touching_parts(np.random.default_rng(13351), 1e-7)
    light = simplify(mesh, method="seams", ratio=0.3, fit=fit).mesh
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    margin = 0.051 * np.linalg.norm(high - low)
    assert (light.vertices >= low - margin).all()
    assert (light.vertices <= high + margin).all()
