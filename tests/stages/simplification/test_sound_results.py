"""Soundness: every method gives finite coordinates close to the input."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from coloured_meshes import MESHES
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_meshes import varied_meshes
from seamed_meshes import folded_strips, wrapped_ball
from simplification_checks import assert_within_bounds, make_parameters

from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.simplification.methods import METHODS, Method
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh

each_method = pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
MADE = {**MESHES, "wrapped": wrapped_ball, "folded": folded_strips}
SHARED = (
    "Duck.glb",
    "CesiumMilkTruck.glb",
    "fuze/fuze.obj",
    "spot/spot_triangulated.obj",
    "bunny10k_textured/bunny10k_textured.obj",
    "pirate.obj",
    "cow.obj",
    "fandisk.obj",
    "textured_scans/can.glb",
)
# Relative to the diagonal. Optimal placement leaves the box farther, the fewer triangles are left: by 4 % at
# 5 % of the triangles of fuze, and by 15 % for 20 random triangles.
FREE_AT_RATIO = {0.3: 0.01, 0.05: 0.06}
FREE_IN_SOUPS = 0.3


@st.composite
def draw_soups(draw: st.DrawFn) -> Mesh:
    """Draw triangles between few points, with coincident points, and flat and duplicate triangles."""
    points, triangles = draw(st.integers(3, 10)), draw(st.integers(1, 20))
    number = st.sampled_from([0.0, 1.0, 2.0, 0.5, -1.0, 1e-3, 100.0])
    index = st.integers(0, points - 1)
    vertices = draw(st.lists(st.tuples(number, number, number), min_size=points, max_size=points))
    corners = draw(st.lists(st.tuples(index, index, index), min_size=triangles, max_size=triangles))
    return Mesh(np.array(vertices), np.array(corners, np.int32))


def require_sound(mesh: Mesh, method: Method[Any, Any], ratio: float, free_share: float) -> None:
    """Simplify and check; a mesh that the method refuses with an error is accepted."""
    parameters = make_parameters(method, mesh, ratio=ratio)
    if parameters.get("max_shape") == 0:
        return
    try:
        simplified = simplify(mesh, **parameters).mesh
    except (MeshError, UsageError):
        return
    assert_within_bounds(simplified, mesh, parameters.get("max_shape"), free_share)


@each_method
@pytest.mark.parametrize("name", MADE)
def test_results_of_generated_meshes_are_close_to_the_input(name: str, method: Method[Any, Any]) -> None:
    require_sound(MADE[name](), method, 0.3, FREE_AT_RATIO[0.3])


@each_method
@pytest.mark.parametrize("name", SHARED)
def test_results_of_shared_meshes_are_close_to_the_input(
    shared_data, name: str, method: Method[Any, Any]
) -> None:
    mesh = read_mesh(shared_data / "meshes" / name)
    for ratio, free_share in FREE_AT_RATIO.items():
        require_sound(mesh, method, ratio, free_share)


@each_method
@given(mesh=draw_soups())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_results_of_soups_are_close_to_the_input(mesh: Mesh, method: Method[Any, Any]) -> None:
    require_sound(mesh, method, 0.3, FREE_IN_SOUPS)


@each_method
@given(mesh=varied_meshes())
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
def test_results_of_meshes_with_any_attributes_are_close_to_the_input(
    mesh: Mesh, method: Method[Any, Any]
) -> None:
    require_sound(mesh, method, 0.3, FREE_IN_SOUPS)


@pytest.mark.parametrize("field", ["vertices", "normals"])
def test_the_check_detects_values_that_are_not_finite(field: str) -> None:
    mesh = MESHES["ball"]()
    mesh = mesh.with_(normals=mesh.vertices.copy())
    array = getattr(mesh, field).copy()
    array[5, 1] = np.nan
    with pytest.raises(AssertionError, match="not finite"):
        assert_within_bounds(mesh.with_(**{field: array}), mesh)


def test_the_check_detects_a_vertex_outside() -> None:
    mesh = MESHES["ball"]()
    moved = mesh.vertices.copy()
    farthest = int(moved[:, 0].argmax())
    moved[farthest] *= 1.2
    with pytest.raises(AssertionError, match=f"vertex {farthest} lies"):
        assert_within_bounds(mesh.with_(vertices=moved), mesh)
    assert_within_bounds(mesh.with_(vertices=moved), mesh, max_shape=0.3)
