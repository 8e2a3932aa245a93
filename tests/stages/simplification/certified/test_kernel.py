"""Bounded simplification, checked by sampling with an independent search."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.certified.details import CertifiedDetails
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, interpolate_values
from scanloom.stages.surface.topology import topology

pytestmark = pytest.mark.slow


def make_height_field(size: int, bumps: NDArray[np.float64], colors: NDArray[np.uint8] | None = None) -> Mesh:
    """Make a square sheet of size × size vertices, a unit apart, at the given heights."""
    y, x = np.mgrid[:size, :size]
    vertices = np.stack([x, y, bumps], axis=2).reshape(-1, 3).astype(np.float64)
    a = (np.arange(size - 1)[:, None] * size + np.arange(size - 1)).ravel()
    b, c, d = a + 1, a + size + 1, a + size
    triangles = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    return Mesh(vertices, triangles.astype(np.int32), colors=colors)


def sample_points(mesh: Mesh, count: int, rng: np.random.Generator) -> tuple[NDArray[np.float64], ...]:
    """Sample corners, edge midpoints and random points of a surface: positions and colours."""
    corners = mesh.triangles
    weights = rng.dirichlet([0.5, 0.5, 0.5], size=count)
    of = rng.integers(len(corners), size=count)
    fixed = np.array([[1, 0, 0], [0.5, 0.5, 0], [0.75, 0.25, 0], [1 / 3, 1 / 3, 1 / 3]])
    every = np.arange(len(corners))
    of = np.concatenate([of, *[every for _ in fixed]])
    weights = np.concatenate([weights, *[np.broadcast_to(w, (len(corners), 3)) for w in fixed]])
    places = np.einsum("kc,kcx->kx", weights, mesh.vertices[corners[of]])
    if mesh.colors is None:
        return places, np.zeros((len(places), 0))
    return places, np.einsum("kc,kcx->kx", weights, mesh.colors[corners[of]].astype(np.float64))


# Practically zero: below the smallest provable bound.
TINY = 1e-300


def simplify_certified(mesh: Mesh, **changes: Any) -> SimplificationResult[CertifiedDetails]:
    """Simplify with method certified."""
    return simplify(mesh, method="certified", **changes)


def assert_samples_within_bounds(
    result: SimplificationResult[CertifiedDetails], mesh: Mesh, count: int = 20_000
) -> None:
    """Check that sampled points of both surfaces are within the bounds."""
    rng = np.random.default_rng(7)
    assert result.details.shape_bound_m is not None
    for one, other in ((result.mesh, mesh), (mesh, result.mesh)):
        places, colors = sample_points(one, count, rng)
        found = RaycastingSurface(other).find_closest_points(places)
        assert found.distances.max() <= result.details.shape_bound_m
        if result.details.color_bound_levels is not None and other.colors is not None:
            there = interpolate_values(other.colors, other, found)
            assert np.linalg.norm(there - colors, axis=1).max() <= result.details.color_bound_levels


@given(
    size=st.integers(4, 12),
    seed=st.integers(0, 2**32 - 1),
    roughness=st.sampled_from([0.0, 0.05, 0.5]),
    shape=st.sampled_from([TINY, 0.02, 0.2, 1.0]),
    color=st.sampled_from([None, 5.0, 60.0]),
)
@settings(max_examples=60, deadline=None)
def test_no_sample_of_a_random_sheet_exceeds_the_bounds(
    size: int, seed: int, roughness: float, shape: float, color: float | None
) -> None:
    rng = np.random.default_rng(seed)
    smooth = np.sin(np.linspace(0, 3, size))[:, None] * np.cos(np.linspace(0, 2, size))
    paint = rng.integers(0, 256, (3, 1, 1)) * smooth + 20 * roughness * rng.normal(size=(3, size, size))
    colors = np.rint(paint).clip(0, 255).astype(np.uint8).reshape(3, -1).T.copy()
    mesh = make_height_field(size, smooth + roughness * rng.normal(size=(size, size)), colors)
    result = simplify_certified(mesh, max_shape=shape, max_color=color, threads=1)
    assert_samples_within_bounds(result, mesh, 2_000)
    assert result.details.shape_attained_m <= result.details.shape_bound_m
    if result.details.proven:
        assert result.details.shape_bound_m <= max(shape, 2 * result.details.slack_m)
        if color is not None and result.details.color_bound_levels is not None:
            assert result.details.color_bound_levels <= color


def test_a_flat_sheet_of_one_colour_is_simplified_with_zero_bounds() -> None:
    colors = np.full((400, 3), 77, np.uint8)
    mesh = make_height_field(20, np.zeros((20, 20)), colors)
    result = simplify_certified(mesh, max_shape=TINY, max_color=0.0)
    assert result.details.proven
    assert len(result.mesh.triangles) <= 12
    assert result.mesh.colors is not None
    assert (result.mesh.colors == 77).all()


def test_a_larger_bound_leaves_fewer_triangles() -> None:
    x = np.linspace(0, 6, 40)
    mesh = make_height_field(40, np.sin(x)[:, None] * np.cos(x))
    left = [len(simplify_certified(mesh, max_shape=bound).mesh.triangles) for bound in (0.01, 0.05, 0.2)]
    assert left == sorted(left, reverse=True)
    assert left[2] < left[0] / 3


def test_only_the_colour_can_be_bounded() -> None:
    half = np.zeros((20, 20, 3), np.uint8)
    half[:, 10:] = 200
    mesh = make_height_field(20, np.zeros((20, 20)), half.reshape(-1, 3))
    result = simplify_certified(mesh, max_color=8.0)
    assert_samples_within_bounds(result, mesh)
    assert result.details.proven
    assert result.details.color_bound_levels is not None
    assert result.details.color_bound_levels <= 8.0
    assert len(result.mesh.triangles) < len(mesh.triangles) / 3


def test_important_vertices_get_a_smaller_bound() -> None:
    x = np.linspace(0, 6, 40)
    mesh = make_height_field(40, np.sin(x)[:, None] * np.cos(x))
    importance = np.where(mesh.vertices[:, 0] < 20, 8.0, 1.0)
    result = simplify_certified(mesh, max_shape=0.2, importance=importance)
    far = RaycastingSurface(result.mesh).find_closest_points(mesh.vertices).distances
    assert far[mesh.vertices[:, 0] < 20].max() <= 0.2 / 8
    assert far[mesh.vertices[:, 0] >= 20].max() > 0.2 / 8


def test_one_and_two_threads_give_the_same_bytes(shared_data: Path) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / "camelhead.off")).mesh
    one, two = (simplify_certified(mesh, max_shape=5e-4, threads=threads) for threads in (1, 2))
    assert one.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()
    assert one.mesh.triangles.tobytes() == two.mesh.triangles.tobytes()
    assert one.details.shape_bound.tobytes() == two.details.shape_bound.tobytes()


@pytest.mark.parametrize(
    ("name", "relative"),
    [("cow.obj", 2e-3), ("fandisk.obj", 1e-3), ("rocker-arm.obj", 1e-3), ("camelhead.off", 2e-3)],
)
def test_the_bound_of_a_shared_mesh_holds_and_is_tight(shared_data: Path, name: str, relative: float) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / name)).mesh
    bound = relative * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    result = simplify_certified(mesh, max_shape=bound)
    assert result.details.proven
    assert result.details.shape_bound_m <= bound
    assert_samples_within_bounds(result, mesh, 200_000)
    assert result.details.shape_bound_m <= 1.3 * result.details.shape_attained_m
    assert topology(result.mesh).euler == topology(mesh).euler


def test_the_bounds_of_a_part_of_the_kitchen_scan_hold(shared_data: Path) -> None:
    mesh = read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")
    centre = np.median(mesh.vertices, axis=0)
    near = np.abs(mesh.vertices - centre).max(axis=1) < 0.6
    mesh = clean(mesh.with_(triangles=mesh.triangles[near[mesh.triangles].all(axis=1)])).mesh
    result = simplify_certified(mesh, max_shape=0.01, max_color=40.0)
    assert result.details.proven
    assert result.details.shape_bound_m <= 0.01
    assert result.details.color_bound_levels is not None
    assert result.details.color_bound_levels <= 40.0
    assert_samples_within_bounds(result, mesh, 200_000)
    assert len(result.mesh.triangles) < 0.2 * len(mesh.triangles)
    assert topology(result.mesh).boundary_loops == topology(mesh).boundary_loops


def test_invalid_parameters_are_one_error() -> None:
    mesh = make_height_field(4, np.zeros((4, 4)))
    with pytest.raises(
        UsageError, match="method certified needs an error bound; give max_shape, max_color or both"
    ):
        simplify_certified(mesh)
    with pytest.raises(UsageError, match="max_shape is -1 m; it must be more than 0 m"):
        simplify_certified(mesh, max_shape=-1.0)
    with pytest.raises(UsageError, match="no vertex colours"):
        simplify_certified(mesh, max_color=3.0)
    with pytest.raises(UsageError, match="importance has values below 1"):
        simplify_certified(mesh, max_shape=1.0, importance=np.full(16, 0.5))
