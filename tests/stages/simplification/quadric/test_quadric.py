"""Method quadric: triangle counts, topology, colours, repeatability."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from coloured_meshes import MESHES, assert_same_topology, ball, sheet
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import Delaunay

from scanloom.stages import _kernels
from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.compare import compare
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.progress import ignore_progress
from scanloom.stages.simplification.codes import SIMPLIFY_EDGES_BLOCKED
from scanloom.stages.simplification.regions import Sphere
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import as_mesh, to_open3d_legacy
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.topology import topology


def compute_normals(mesh: Mesh) -> NDArray[np.float64]:
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    return np.cross(b - a, c - a)


def measure_errors(mesh: Mesh, light: Mesh) -> tuple[float, float]:
    """Measure the RMS distance in metres and the RMS colour difference in levels."""
    measured = compare(mesh, light, samples=40_000)
    assert measured.color is not None
    return measured.symmetric.rms, measured.color.rmse


# -- counts and topology ---------------------------------------------------------------------------------


@pytest.mark.parametrize("fit", [True, False], ids=["fitted", "plain"])
@pytest.mark.parametrize("triangles", [60, 301, 1200])
@pytest.mark.parametrize("name", MESHES)
def test_the_count_is_reached_and_topology_kept(name: str, triangles: int, fit: bool) -> None:
    mesh = MESHES[name]()
    result = simplify(mesh, triangles=triangles, fit=fit)
    assert result.method == "quadric"
    assert result.stopped_by == "triangles"
    assert triangles - 1 <= len(result.mesh.triangles) <= triangles
    assert_same_topology(result.mesh, mesh)


def test_a_ratio_is_converted_to_a_count() -> None:
    mesh = sheet()
    by_ratio, by_count = simplify(mesh, ratio=0.125), simplify(mesh, triangles=400)
    np.testing.assert_array_equal(by_ratio.mesh.vertices, by_count.mesh.vertices)


@pytest.mark.parametrize("name", MESHES)
def test_the_smallest_mesh_is_limited_by_topology(name: str) -> None:
    mesh = MESHES[name]()
    result = simplify(mesh, triangles=1)
    # A disc can shrink to the single requested triangle.
    assert result.stopped_by == ("triangles" if len(result.mesh.triangles) == 1 else "bounds")
    assert len(result.mesh.triangles) < 60
    if result.stopped_by == "bounds":
        assert sum(result.refused.values()) == topology(result.mesh).edges
    assert_same_topology(result.mesh, mesh)


def test_a_count_too_small_for_the_holes_is_reported() -> None:
    mesh = sheet()
    square = np.floor(mesh.vertices[mesh.triangles].mean(axis=1)[:, :2] * 40)
    torn = Mesh(mesh.vertices, mesh.triangles[(square % 4 != 1).any(axis=1)], colors=mesh.colors)
    loops = topology(torn).boundary_loops
    assert loops > 90

    def list_warnings(found: SimplificationResult[Any]) -> list[str]:
        return [str(one) for one in found.diagnostics if one.code == SIMPLIFY_EDGES_BLOCKED.name]

    (warning,) = list_warnings(simplify(torn, triangles=4 * loops))
    assert "holes" in warning
    assert list_warnings(simplify(torn, ratio=0.5)) == []
    assert list_warnings(simplify(torn, max_shape=1.0)) == []
    assert simplify(mesh, triangles=4 * loops).diagnostics == ()


@pytest.mark.parametrize("ratio", [0.5, 0.1, 0.02])
def test_no_triangle_flips(ratio: float) -> None:
    mesh = sheet(noise=0.0)
    assert (compute_normals(simplify(mesh, ratio=ratio).mesh)[:, 2] > 0).all()
    light = simplify(ball(), ratio=ratio).mesh
    outwards = light.vertices[light.triangles].mean(axis=1)
    assert (np.einsum("ij,ij->i", compute_normals(light), outwards) > 0).all()


@pytest.mark.parametrize("region", [40, 300, 2000, 1_000_000])
@pytest.mark.parametrize("name", MESHES)
def test_regions_of_any_size_give_a_sound_mesh(name: str, region: int) -> None:
    mesh = MESHES[name]()
    assert mesh.colors is not None
    running = _kernels.RunSettings(target_triangles=200, region_triangles=region)
    result = _kernels.simplify_by_quadrics(
        mesh.vertices,
        mesh.colors.astype(np.float64),
        mesh.triangles,
        np.zeros(0, bool),
        np.zeros(0),
        weight=1e-4,
        running=running,
        progress=ignore_progress,
    )
    assert 199 <= len(result.triangles) <= 200
    assert_same_topology(Mesh(result.vertices, result.triangles), mesh)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(5, 120),
    gone=st.floats(0, 0.4),
    roughness=st.sampled_from([0.0, 0.05, 1.0]),
    share=st.floats(0.05, 1.0),
    colored=st.booleans(),
    fit=st.booleans(),
    locked=st.floats(0, 0.5),
    importance=st.booleans(),
)
def test_random_meshes_keep_topology_locks_and_record(
    seed: int,
    count: int,
    gone: float,
    roughness: float,
    share: float,
    colored: bool,
    fit: bool,
    locked: float,
    importance: bool,
) -> None:
    random = np.random.default_rng(seed)
    flat = random.random((count, 2))
    triangles = Delaunay(flat).simplices.astype(np.int32)
    stays = random.random(len(triangles)) >= gone
    stays[0] = True
    triangles = triangles[stays]
    vertices = np.column_stack([flat, roughness * random.random(count)])
    a, b, c = (flat[triangles[:, i]] for i in range(3))
    clockwise = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    colors = random.integers(0, 256, (count, 3)).astype(np.uint8) if colored else None
    mesh = clean(Mesh(vertices, triangles, colors=colors), min_island_area=0).mesh
    lock = random.random(len(mesh.vertices)) < locked
    factors = np.exp(random.normal(0, 5, len(mesh.vertices))) if importance else None
    result = simplify(mesh, ratio=share, fit=fit, record=True, lock=lock, importance=factors)
    wanted = int(share * len(mesh.triangles))
    assert len(result.mesh.triangles) <= wanted or result.stopped_by == "bounds"
    assert len(result.mesh.triangles) >= wanted - 1
    assert_same_topology(result.mesh, mesh)
    at = np.searchsorted(result.vertex_source, np.flatnonzero(lock))
    np.testing.assert_array_equal(result.mesh.vertices[at], mesh.vertices[lock])
    if mesh.colors is not None:
        assert result.mesh.colors is not None
        np.testing.assert_array_equal(result.mesh.colors[at], mesh.colors[lock])
    if roughness == 0:
        assert (compute_normals(result.mesh)[:, 2] > 0).all()
        np.testing.assert_allclose(result.mesh.vertices[:, 2], 0, atol=1e-12)
    assert result.record is not None
    replayed = result.record.replay(fit=result.details.fitted)
    np.testing.assert_array_equal(replayed.mesh.vertices, result.mesh.vertices)
    np.testing.assert_array_equal(replayed.mesh.triangles, result.mesh.triangles)


# -- error -----------------------------------------------------------------------------------------------


def test_a_flat_sheet_with_linear_colours_has_no_error() -> None:
    mesh = sheet(noise=0.0, height=0.0)
    assert mesh.colors is not None
    even = mesh.with_(colors=mesh.colors * np.array([1, 1, 0], np.uint8))
    light = simplify(even, triangles=2).mesh
    assert len(light.triangles) == 2
    shape, color = measure_errors(even, light)
    assert shape < 1e-6
    assert color < 1  # rounding to eight bits


def test_a_colour_edge_on_a_flat_wall_is_kept() -> None:
    wall = sheet(60, noise=0.0, height=0.0)
    blind, seeing = (simplify(wall, triangles=60, attribute_scale=scale).mesh for scale in (0.0, 1e-4))
    assert measure_errors(wall, seeing)[1] < 0.25 * measure_errors(wall, blind)[1]


def test_fitting_reduces_shape_and_colour_errors() -> None:
    mesh = sheet(80)
    plain, fitted = (simplify(mesh, ratio=0.05, fit=fit) for fit in (False, True))
    assert (plain.details.fitted, fitted.details.fitted) == (False, True)
    np.testing.assert_array_equal(plain.mesh.triangles, fitted.mesh.triangles)
    assert measure_errors(mesh, fitted.mesh)[0] < measure_errors(mesh, plain.mesh)[0]
    assert measure_errors(mesh, fitted.mesh)[1] < measure_errors(mesh, plain.mesh)[1]


def simplify_with_open3d(mesh: Mesh, triangles: int) -> Mesh:
    return as_mesh(to_open3d_legacy(mesh).simplify_quadric_decimation(triangles))


@pytest.mark.parametrize("name", ["sheet", "ball", "ring"])
def test_errors_are_smaller_than_those_of_open3d(name: str) -> None:
    mesh = MESHES[name]()
    light = simplify(mesh, ratio=0.1).mesh
    ours, theirs = (
        measure_errors(mesh, light),
        measure_errors(mesh, simplify_with_open3d(mesh, len(light.triangles))),
    )
    assert ours[0] < theirs[0]
    assert ours[1] < theirs[1]


@pytest.mark.parametrize("name", ["fandisk.obj", "camelhead.off", "rocker-arm.obj"])
def test_colours_cost_little_shape_error_by_default(shared_data: Path, name: str) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / name)).mesh
    at = 40 * mesh.vertices / np.ptp(mesh.vertices, axis=0).max()
    mesh = mesh.with_(colors=(128 + 120 * np.sin(at) * np.cos(2 * at[:, ::-1])).astype(np.uint8))
    weights = None, 0.0
    best = [simplify(mesh, ratio=0.1, attribute_scale=weight).mesh for weight in weights]
    found = [compare(mesh, light, samples=50_000) for light in best]
    # Measured ratio: 1.2, without the fit and at vertices.
    assert found[0].symmetric.rms < 1.3 * found[1].symmetric.rms
    errors = [one.color.rmse for one in found if one.color is not None]
    assert errors[0] < 0.9 * errors[1]


def test_errors_on_the_horse_and_the_kitchen_are_smaller_than_those_of_open3d(shared_data: Path) -> None:
    horse = clean(read_mesh(shared_data / "meshes" / "horse.ply")).mesh
    light = simplify(horse, ratio=0.1).mesh
    assert_same_topology(light, horse)
    theirs = simplify_with_open3d(horse, len(light.triangles))
    ours_rms, their_rms = (compare(horse, m, samples=200_000).symmetric.rms for m in (light, theirs))
    assert ours_rms < 0.75 * their_rms

    kitchen = clean(read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")).mesh
    light = simplify(kitchen, ratio=0.1).mesh
    assert_same_topology(light, kitchen)
    ours, other = (
        measure_errors(kitchen, light),
        measure_errors(kitchen, simplify_with_open3d(kitchen, len(light.triangles))),
    )
    assert ours[0] < other[0]
    assert ours[1] < other[1]


# -- colours ---------------------------------------------------------------------------------------------


def test_a_single_colour_is_kept() -> None:
    mesh = sheet()
    grey = mesh.with_(colors=np.full((len(mesh.vertices), 3), 77, np.uint8))
    assert np.unique(simplify(grey, ratio=0.05).mesh.colors).tolist() == [77]


def test_colours_stay_in_range() -> None:
    mesh = sheet()
    random = np.random.default_rng(2)
    loud = mesh.with_(colors=(255 * random.integers(0, 2, (len(mesh.vertices), 3))).astype(np.uint8))
    colors = simplify(loud, ratio=0.1).mesh.colors
    assert colors is not None
    # An overflow would have wrapped around; the mean of black and white is grey.
    assert 100 < colors.mean() < 155


def test_colours_without_weight_have_no_effect() -> None:
    mesh = sheet()
    colored = simplify(mesh, ratio=0.1, attribute_scale=0.0)
    plain = simplify(mesh.with_(colors=None), ratio=0.1)
    np.testing.assert_array_equal(colored.mesh.triangles, plain.mesh.triangles)
    np.testing.assert_array_equal(colored.mesh.vertices, plain.mesh.vertices)


# -- repeatability ---------------------------------------------------------------------------------------


def test_the_bytes_do_not_depend_on_the_thread_count() -> None:
    mesh = sheet(150)  # several patches
    one, *others = [simplify(mesh, ratio=0.1, threads=threads) for threads in (1, 1, 2, 3)]
    assert one.mesh.colors is not None
    for other in others:
        assert other.mesh.colors is not None
        assert other.mesh.vertices.tobytes() == one.mesh.vertices.tobytes()
        assert other.mesh.colors.tobytes() == one.mesh.colors.tobytes()
        assert other.mesh.triangles.tobytes() == one.mesh.triangles.tobytes()
        assert other.vertex_source.tobytes() == one.vertex_source.tobytes()
        assert other.triangle_source.tobytes() == one.triangle_source.tobytes()
        assert other.to_dict() == one.to_dict()


def test_far_from_the_origin_only_rounding_differs() -> None:
    mesh = sheet()
    here = simplify(mesh, ratio=0.1)
    away = simplify(mesh.with_(vertices=mesh.vertices + 1e6), ratio=0.1)
    np.testing.assert_array_equal(away.mesh.triangles, here.mesh.triangles)
    np.testing.assert_array_equal(away.vertex_source, here.vertex_source)
    # Coordinates are rounded to 1e-10; on an almost flat surface, a vertex slides farther than that.
    np.testing.assert_allclose(away.mesh.vertices - 1e6, here.mesh.vertices, atol=1e-5)
    assert here.mesh.colors is not None
    assert away.mesh.colors is not None
    assert np.abs(away.mesh.colors.astype(int) - here.mesh.colors).max() <= 1


@pytest.mark.parametrize("exponent", [-20, 20])
def test_the_size_of_the_mesh_does_not_matter(exponent: int) -> None:
    mesh = sheet()
    factor = 2.0**exponent
    here, other = simplify(mesh, ratio=0.1), simplify(mesh.with_(vertices=mesh.vertices * factor), ratio=0.1)
    np.testing.assert_array_equal(other.mesh.triangles, here.mesh.triangles)
    np.testing.assert_allclose(other.mesh.vertices / factor, here.mesh.vertices, atol=1e-9)


# -- sources ---------------------------------------------------------------------------------------------


def test_other_attributes_follow_their_source_vertices() -> None:
    mesh = sheet()
    result = simplify(mesh, ratio=0.2)
    assert len(np.unique(result.vertex_source)) == len(result.mesh.vertices)
    confidence = np.linspace(0, 1, len(mesh.vertices))
    np.testing.assert_array_equal(result.map_vertex_values(confidence), confidence[result.vertex_source])
    apart = np.linalg.norm(result.mesh.vertices - result.map_vertex_values(mesh.vertices), axis=1)
    corners = result.mesh.vertices[result.mesh.triangles]
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max()
    assert apart.max() < longest
    now = corners.mean(axis=1)
    then = mesh.vertices[mesh.triangles[result.triangle_source]].mean(axis=1)
    assert np.linalg.norm(now - then, axis=1).max() < 2 * longest


# -- bad input -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "quadric"}, "needs a triangle count"),
        (
            {"method": "quadric", "ratio": 0.5, "max_shape": 1.0},
            "max_shape is not supported by method quadric",
        ),
        ({"method": "quadric", "ratio": 0.5, "jia01": {"paper_rule": True}}, "paper_rule is not supported"),
        ({"method": "magic"}, "method is 'magic'; it must be one of auto, quadric"),
        (
            {"jia01": {"resolution": 0.1}, "importance": np.full(36, 2.0)},
            "importance is not supported by method jia01",
        ),
        ({"max_shape": 0.1, "importance": np.full(36, 0.5)}, "importance has values below 1"),
        ({"method": "certified"}, "certified needs an error bound"),
        (
            {"ratio": 0.5, "certified": {"tight_bounds": True}},
            "tight_bounds belongs to method certified, which needs max_shape or",
        ),
        (
            {"method": "jia01", "max_shape": 0.1, "certified": {"tight_bounds": True}},
            "tight_bounds is not supported by method jia01; leave one of them out",
        ),
        (
            {"method": "certified", "max_shape": 0.1, "jia01": {"resolution": 1.0}},
            "resolution is not supported by method certified",
        ),
        ({"ratio": 0.5, "lock": np.ones(5, bool)}, "lock has shape .5,.; one value for each of 36"),
        ({"ratio": 0.5, "lock": [0, 36]}, "lock contains vertex index 36, but the mesh has 36"),
        ({"ratio": 0.5, "lock": [-1]}, "lock contains vertex index -1"),
        ({"ratio": 0.5, "lock": [0.5]}, "list of vertex indices"),
        ({"ratio": 0.5, "importance": np.ones(5)}, "importance has shape .5,."),
        ({"ratio": 0.5, "importance": np.zeros(36)}, "importance of vertex 0 is 0.0; it must be above 0"),
        ({"ratio": 0.5, "importance": np.full(36, np.nan)}, "importance of vertex 0 is nan"),
        ({"ratio": 0.5, "importance": ["a"] * 36}, "one number for each of 36"),
        ({"ratio": 0.5, "regions": [Sphere((9, 9, 9), 1, lock=True)]}, "sphere about .9, 9, 9. .* no vertex"),
        ({"ratio": 0.5, "threads": 0}, "threads is 0; it must be at least 1"),
    ],
)
def test_invalid_parameters_are_reported(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simplify(sheet(5), **arguments)


def test_an_empty_mesh_is_simplified() -> None:
    empty = simplify((np.zeros((0, 3)), np.zeros((0, 3), np.int32)), triangles=5, record=True)
    assert empty.mesh.vertices.shape == (0, 3)
    assert empty.record is not None
    assert empty.record.replay().mesh.triangles.shape == (0, 3)
    json.dumps(empty.to_dict())


def test_loose_vertices_and_degenerate_triangles_are_ignored() -> None:
    mesh = sheet()
    assert mesh.colors is not None
    far = np.concatenate([mesh.vertices, [[1e30, 0, 0]]])
    twice = np.concatenate([mesh.triangles, [[3, 3, 4]]]).astype(np.int32)
    odd = Mesh(far, twice, colors=np.concatenate([mesh.colors, [[0, 0, 0]]]).astype(np.uint8))
    one, other = (simplify(m, triangles=300, attribute_scale=1e-4, record=True) for m in (mesh, odd))
    assert other.record is not None
    replayed = other.record.replay(fit=True)
    for result in (other, replayed):
        np.testing.assert_array_equal(one.mesh.vertices, result.mesh.vertices)
        np.testing.assert_array_equal(one.mesh.triangles, result.mesh.triangles)
    assert len(other.record.replay(collapses=0).mesh.triangles) == len(mesh.triangles)


@pytest.mark.parametrize("squash", [(1, 0, 0), (0, 0, 0)], ids=["line", "point"])
def test_triangles_without_area_are_accepted(squash: tuple[int, int, int]) -> None:
    mesh = sheet(12)
    result = simplify(mesh.with_(vertices=mesh.vertices * squash), ratio=0.2)
    assert np.isfinite(result.mesh.vertices).all()
    assert topology(result.mesh).is_manifold


def test_metrics_describe_the_method() -> None:
    metrics = simplify(sheet(), ratio=0.25).to_dict()
    assert json.loads(json.dumps(metrics)) == metrics
    assert metrics["method"] == "quadric"
    assert metrics["details"]["fitted"] is True
    assert metrics["details"]["attribute_scale_m_per_level"] > 0
    assert metrics["triangles"] <= 800 < metrics["triangles_before"] == 3200
