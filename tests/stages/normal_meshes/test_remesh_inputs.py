"""Inputs of remesh: accepted meshes, transferred attributes, and refused input."""

from __future__ import annotations

import json
from collections.abc import Callable

import coloured_meshes
import numpy as np
import pytest
import trimesh
from coloured_meshes import MESHES
from normal_mesh_checks import (
    EXACT_PARAMETERS,
    SMALL_PARAMETERS,
    assert_valid_normal_mesh,
    compute_diagonal,
    remesh_cached,
)
from numpy.typing import NDArray

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.normal_meshes.normal_mesh import BOUNDARY, EXCEPTION
from scanloom.stages.normal_meshes.remesh import RemeshParams, remesh
from scanloom.stages.surface.codes import MESH_LEFT_OUT
from scanloom.stages.surface.mesh import Mesh, Texture
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_closest_weights, interpolate_values
from scanloom.stages.surface.topology import topology

pytestmark = pytest.mark.slow

made = pytest.mark.parametrize("make", MESHES.values(), ids=MESHES)


# -- transferred attributes -------------------------------------------------------------------------------


@made
@pytest.mark.parametrize("tolerance", [0.0, 2.0, 8.0])
def test_colours_are_interpolated_on_the_surface(make: Callable[[], Mesh], tolerance: float) -> None:
    mesh = make()
    found = remesh(mesh, color_tolerance=tolerance, **EXACT_PARAMETERS)
    for level in found.levels:
        there = interpolate_values(
            mesh.colors, mesh, RaycastingSurface(mesh).find_closest_points(level.vertices)
        )
        # Half a level for rounding, and 0.1 for points at an edge, which may get either triangle.
        assert np.abs(level.colors - there).max() <= tolerance + 0.6


def test_a_mesh_without_colours_gets_none() -> None:
    mesh = coloured_meshes.ball().with_(colors=None)
    assert all(level.colors is None for level in remesh(mesh, **EXACT_PARAMETERS).levels)


@made
def test_confidence_is_stored_in_eight_bits(make: Callable[[], Mesh]) -> None:
    mesh = make()
    confidence = 3 - 2 * mesh.vertices[:, 0] + mesh.vertices[:, 1]
    found = remesh(mesh, confidence=confidence, **EXACT_PARAMETERS)
    assert found.confidence is not None
    for level, carried in zip(found.levels, found.confidence, strict=True):
        assert carried.shape == (len(level.vertices),)
        # Confidence is linear in space, so its value follows from the position alone.
        there = 3 - 2 * level.vertices[:, 0] + level.vertices[:, 1]
        assert np.abs(carried - there).max() <= 0.51 * np.ptp(confidence) / 255
    assert remesh_cached(make)[1].confidence is None


def test_constant_confidence_is_kept() -> None:
    mesh = coloured_meshes.ball()
    found = remesh(mesh, confidence=np.full(len(mesh.vertices), 0.75), **EXACT_PARAMETERS)
    for carried in found.confidence:
        np.testing.assert_allclose(carried, 0.75, atol=1e-6)


def test_dropped_attributes_are_reported() -> None:
    mesh = coloured_meshes.ball()
    uvs = np.zeros((len(mesh.triangles), 3, 2))
    read = MESH_LEFT_OUT.warning("read from a file", "a.ply")
    loaded = mesh.with_(
        normals=mesh.vertices.copy(),
        texture=Texture(uvs, np.full(len(uvs), -1, np.int32)),
        diagnostics=(read,),
    )
    found = remesh(loaded, **EXACT_PARAMETERS)
    assert found.mesh.texture is None
    assert found.mesh.normals is None
    assert found.mesh.diagnostics == (read,)
    normals, texture = found.diagnostics
    assert str(normals).startswith("remesh left out: normals;")
    assert str(texture).startswith("remesh discards the texture;")
    plain = remesh_cached(coloured_meshes.ball)[1]
    assert plain.diagnostics == plain.mesh.diagnostics == ()


@made
def test_each_vertex_is_on_its_source_triangle(make: Callable[[], Mesh]) -> None:
    mesh, found = remesh_cached(make)
    assert found.triangle_source is not None
    for level, source in zip(found.levels, found.triangle_source, strict=True):
        corners = mesh.vertices[mesh.triangles[source]]
        foot = np.einsum("kc,kcx->kx", compute_closest_weights(level.vertices, corners), corners)
        assert np.linalg.norm(level.vertices - foot, axis=1).max() <= 1e-6 * compute_diagonal(mesh)


# -- accepted meshes --------------------------------------------------------------------------------------


def make_touching_balls() -> Mesh:
    ball = coloured_meshes.ball()
    highest, lowest = ball.vertices[:, 2].argmax(), ball.vertices[:, 2].argmin()
    count = len(ball.vertices)
    other = ball.triangles + count
    other[other == count + lowest] = highest
    lift = ball.vertices[highest] - ball.vertices[lowest]
    return Mesh(
        np.concatenate([ball.vertices, ball.vertices + lift]),
        np.concatenate([ball.triangles, other]).astype(np.int32),
        colors=np.concatenate([ball.colors, ball.colors]),
    )


def test_pinched_vertices_are_split_and_sources_refer_to_the_input() -> None:
    mesh = make_touching_balls()
    assert topology(mesh).nonmanifold_vertices == 1
    found = remesh(mesh, confidence=mesh.vertices[:, 2], levels=2, base_triangles=160, tolerance=5e-8)
    assert any("1 pinched vertex was split" in str(diagnostic) for diagnostic in found.diagnostics)
    assert topology(found.mesh).is_manifold
    assert topology(found.mesh).components == 2
    apart = np.abs(found.base.vertices - mesh.vertices[found.base_source])
    assert apart.max() <= 1e-7 * compute_diagonal(mesh)
    for source in (found.base_source, *found.triangle_source):
        assert source.min() >= 0
    assert found.triangle_source[-1].max() < len(mesh.triangles)
    there = found.mesh.vertices[:, 2]
    assert np.abs(found.confidence[-1] - there).max() <= 0.01 * np.ptp(there)


def test_loose_vertices_and_degenerate_triangles_are_dropped() -> None:
    mesh = coloured_meshes.ball()
    count = len(mesh.vertices)
    extra = np.array([[5, 5, 7], [count, count + 1, count]], np.int32)
    loose = Mesh(
        np.concatenate([mesh.vertices, [[0, 0, 0.5], [0.5, 0, 0]]]),
        np.concatenate([extra, mesh.triangles]),
        colors=np.concatenate([mesh.colors, mesh.colors[:2]]),
    )
    found, (_, plain) = remesh(loose, **EXACT_PARAMETERS), remesh_cached(coloured_meshes.ball)
    assert found.data == plain.data
    np.testing.assert_array_equal(found.base_source, plain.base_source)
    np.testing.assert_array_equal(found.triangle_source[-1], plain.triangle_source[-1] + 2)


def test_meshes_of_other_libraries_are_accepted() -> None:
    shape = trimesh.creation.icosphere(subdivisions=3)
    pair = (np.array(shape.vertices), np.array(shape.faces))
    assert remesh(shape, levels=1).data == remesh(pair, levels=1).data


def test_the_input_is_not_changed() -> None:
    mesh = make_touching_balls()
    copy = Mesh(mesh.vertices.copy(), mesh.triangles.copy(), colors=mesh.colors.copy())
    remesh(mesh, **EXACT_PARAMETERS)
    for name in ("vertices", "triangles", "colors"):
        np.testing.assert_array_equal(getattr(mesh, name), getattr(copy, name))


def test_the_bytes_do_not_depend_on_the_thread_count() -> None:
    mesh = coloured_meshes.make_holed_sheet()
    one, two, again = (remesh(mesh, threads=threads, **SMALL_PARAMETERS) for threads in (1, 2, 2))
    assert one.data == two.data == again.data
    assert one.mesh.vertices.tobytes() == two.mesh.vertices.tobytes()


@pytest.mark.parametrize("exponent", [-20, 20])
def test_the_scale_of_the_mesh_does_not_matter(exponent: int) -> None:
    mesh, here = remesh_cached(coloured_meshes.ring)
    factor = 2.0**exponent  # about a millionth and a million
    other = remesh(mesh.with_(vertices=mesh.vertices * factor), **EXACT_PARAMETERS)
    np.testing.assert_array_equal(other.mesh.triangles, here.mesh.triangles)
    np.testing.assert_allclose(other.mesh.vertices / factor, here.mesh.vertices, atol=1e-6)


def test_a_mesh_in_map_coordinates_is_remeshed() -> None:
    mesh = coloured_meshes.make_holed_sheet()
    far = mesh.with_(vertices=mesh.vertices + np.array((512_000, 5_400_000, 300)))
    found = remesh(far, **EXACT_PARAMETERS)
    assert_valid_normal_mesh(found, far)


def test_a_mesh_is_refused_where_coordinates_have_too_few_digits_for_its_edges() -> None:
    mesh = coloured_meshes.sheet(4)
    tiny = mesh.with_(vertices=1e-3 * mesh.vertices + 1e9)
    with pytest.raises(MeshError, match=r"shorter than .* m, the precision of coordinates of 1e\+09 m; move"):
        remesh(tiny, **SMALL_PARAMETERS)


def test_a_cube_is_reproduced_to_float_precision() -> None:
    shape = trimesh.creation.box()
    for _ in range(3):
        shape = shape.subdivide()
    mesh = Mesh(np.array(shape.vertices), np.array(shape.faces, np.int32))
    found = remesh(mesh, levels=2, base_triangles=48)
    assert_valid_normal_mesh(found, mesh)
    on_face = np.abs(np.abs(found.mesh.vertices).max(axis=1) - 0.5)
    assert on_face.max() <= 1e-7 * compute_diagonal(mesh)


# -- progress and errors ---------------------------------------------------------------------------------


def test_progress_is_reported_and_can_stop_remesh() -> None:
    mesh = coloured_meshes.sheet(120)
    seen: list[tuple[int, int]] = []
    remesh(mesh, progress=lambda done, total: seen.append((done, total)))
    assert len(seen) >= 2
    assert all(0 <= done <= total for done, total in seen)

    def stop(done: int, total: int) -> None:
        raise ValueError(f"enough at {done} of {total}")

    with pytest.raises(ValueError, match="enough at"):
        remesh(mesh, progress=stop)


def test_a_non_manifold_mesh_is_split_into_sheets() -> None:
    mesh = coloured_meshes.sheet(10)
    fin = mesh.with_(triangles=np.concatenate([mesh.triangles, [[12, 13, 0]]]).astype(np.int32))
    turned = mesh.triangles.copy()
    turned[77] = turned[77, ::-1]
    for broken in (fin, mesh.with_(triangles=turned)):
        found = remesh(broken, levels=1)
        assert topology(found.mesh).is_manifold
        assert any("split" in str(one) for one in found.diagnostics)
        assert found.base_source.max() < len(mesh.vertices)
    assert len(remesh(clean(fin).mesh, levels=1).mesh.triangles) > 0


def test_pinched_vertices_with_a_fin_are_split() -> None:
    mesh = make_touching_balls()
    fin = np.concatenate([mesh.triangles, [[*mesh.triangles[40, :2], 9]]]).astype(np.int32)
    assert topology(remesh(mesh.with_(triangles=fin)).mesh).is_manifold


EMPTY = Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
POINTS = Mesh(np.eye(3), np.array([[0, 0, 1]], np.int32))
LINE = Mesh(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0.0]]), np.array([[0, 1, 2]], np.int32))
HUGE = Mesh(1e200 * np.eye(3), np.array([[0, 1, 2]], np.int32))


@pytest.mark.parametrize(
    ("mesh", "words"),
    [(EMPTY, "no triangles"), (POINTS, "zero area"), (LINE, "zero area"), (HUGE, "too large")],
    ids=["empty", "repeating", "line", "huge"],
)
def test_a_mesh_without_surface_is_one_error(mesh: Mesh, words: str) -> None:
    with pytest.raises(MeshError, match=words):
        remesh(mesh)


@pytest.mark.parametrize(
    "confidence", [np.zeros(3), np.zeros((2562, 2)), np.full(2562, np.nan), np.full(2562, "high")]
)
def test_confidence_must_be_one_finite_number_per_vertex(confidence: NDArray[np.float64]) -> None:
    with pytest.raises(MeshError, match=r"confidence is .* 2562 vertices is expected"):
        remesh(coloured_meshes.ball(), confidence=confidence)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"levels": 11}, "levels is 11; it must be at most 10"),
        ({"levels": -1}, "levels is -1"),
        ({"scheme": "loop"}, "one of linear, butterfly"),
        ({"tolerance": 0.0}, "tolerance is 0"),
        ({"base_triangles": 0}, "base_triangles is 0"),
        ({"max_error": 0.0}, "max_error is 0 m; it must be more than 0 m"),
        ({"bases": 3}, "unknown parameter 'bases'"),
    ],
)
def test_parameters_out_of_range_are_refused(changes: dict[str, object], words: str) -> None:
    with pytest.raises(UsageError, match=words):
        remesh(coloured_meshes.ball(), **changes)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_meshes_of_a_few_triangles_are_remeshed(count: int) -> None:
    fan = np.array([[0, 0, 0], [1, 0, 0], [0.8, 0.6, 0.1], [0, 1, 0.2], [-0.8, 0.6, 0]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 4]], np.int32)[:count]
    mesh = Mesh(fan, triangles)
    found = remesh(mesh, levels=2, tolerance=5e-8)
    assert topology(found.mesh).is_manifold
    assert RaycastingSurface(mesh).find_closest_points(
        found.mesh.vertices
    ).distances.max() <= 1e-6 * compute_diagonal(mesh)


def test_metrics_are_plain_numbers() -> None:
    found = remesh(coloured_meshes.make_holed_sheet(), RemeshParams(levels=2), base_triangles=120)
    metrics = found.to_dict()
    assert json.loads(json.dumps(metrics)) == metrics
    assert metrics["triangles"] == len(found.mesh.triangles) == 16 * metrics["base_triangles"]
    kinds = np.concatenate([offsets.kinds for offsets in found.offsets])
    inside = np.count_nonzero(kinds != BOUNDARY)
    assert metrics["exceptions"] == np.count_nonzero(kinds == EXCEPTION)
    assert metrics["exception_ratio"] == pytest.approx(metrics["exceptions"] / inside)
    assert sum(one["boundary_vertices"] for one in metrics["by_level"]) == len(kinds) - inside > 0
    assert metrics["file_bytes"] == metrics["by_level"][-1]["file_bytes"] == len(found.data)
    assert metrics["bits_per_vertex"] == pytest.approx(8 * len(found.data) / len(found.mesh.vertices))


@pytest.mark.parametrize("far", [1e7, 1e9, 1e15])
def test_a_distant_stray_vertex_is_reported(far: float) -> None:
    mesh = coloured_meshes.ball()
    vertices = mesh.vertices.copy()
    vertices[7] = [far, 0, 0]
    with pytest.raises(MeshError, match=r"vertex 7 is 1e\+\d\d m away\.$"):
        remesh(Mesh(vertices, mesh.triangles))


def test_a_base_of_a_non_manifold_mesh_is_split() -> None:
    ball = coloured_meshes.ball()
    far = ball.vertices + np.array([2 * np.ptp(ball.vertices[:, 0]), 0, 0])
    first, second = np.argmax(ball.vertices[:, 0]), np.argmin(far[:, 0])
    far[second] = ball.vertices[first]
    vertices = np.concatenate([ball.vertices, far])
    pinched = Mesh(vertices, np.concatenate([ball.triangles, ball.triangles + len(ball.vertices)]))
    found = remesh(pinched, levels=0, base_triangles=200, tolerance=1e-3)
    assert topology(found.mesh).is_manifold
    assert len(found.mesh.triangles) <= 200
    assert found.base_source.max() < len(vertices)
