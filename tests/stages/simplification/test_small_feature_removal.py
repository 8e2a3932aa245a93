"""`drop_below` removes small components and holes, and reports all of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from coloured_meshes import sheet
from seamed_meshes import wrapped_ball
from simplification_checks import make_parameters

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.codes import SIMPLIFY_COMPONENTS_REMOVED
from scanloom.stages.simplification.methods import METHODS, Method
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.simplification.small_feature_removal import remove_small_features
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas, topology

# Size of a box next to the sheet, and of a hole in the sheet, which has cells of 0.025.
BOX, HOLE = 0.04, 0.075
LIMIT = 0.12


def make_defective_sheet(boxes: int = 3) -> Mesh:
    """Make a sheet of 1 m with holes of 3 × 3 and 20 × 20 cells, and small boxes above it."""
    mesh = sheet(noise=0.0, height=0.0)
    cell = np.floor(mesh.vertices[mesh.triangles].mean(axis=1)[:, :2] * 40)
    small = np.abs(cell - (8, 8)).max(axis=1) < 2
    large = np.abs(cell - (26, 26)).max(axis=1) < 10
    vertices, triangles, colors = [mesh.vertices], [mesh.triangles[~(small | large)]], [mesh.colors]
    for number in range(boxes):
        box = trimesh.creation.box((BOX, BOX, BOX))
        triangles.append(np.asarray(box.faces) + sum(map(len, vertices)))
        vertices.append(np.asarray(box.vertices) + np.array([0.1 + 0.2 * number, 0.5, 0.5]))
        colors.append(np.full((8, 3), 200, np.uint8))
    return Mesh(
        np.concatenate(vertices), np.concatenate(triangles).astype(np.int32), colors=np.concatenate(colors)
    )


def test_counts_and_areas_are_exact() -> None:
    mesh = make_defective_sheet()
    found = simplify(mesh, ratio=0.1, drop_below=LIMIT)
    dropped = found.dropped
    assert (dropped.components, dropped.component_triangles) == (3, 36)
    assert dropped.component_area_m2 == pytest.approx(3 * 6 * BOX**2)
    # Twelve edges around a hole of three by three cells.
    assert (dropped.holes, dropped.hole_triangles) == (1, 10)
    assert dropped.hole_area_m2 == pytest.approx(HOLE**2)
    now = topology(found.mesh)
    assert (now.components, now.boundary_loops) == (1, 2)
    assert found.triangles_before == len(mesh.triangles)
    assert len(found.mesh.triangles) <= 0.1 * len(mesh.triangles)


def test_removed_features_are_reported() -> None:
    found = simplify(make_defective_sheet(), ratio=0.1, drop_below=LIMIT)
    assert found.to_dict()["dropped"] == found.dropped.to_dict()
    (warning,) = [str(one) for one in found.diagnostics if one.code == SIMPLIFY_COMPONENTS_REMOVED.name]
    assert warning.startswith("drop_below ")
    assert "removed 3 connected components smaller than 0.12 m (36 triangles, 0.0288 m²)" in warning
    assert "filled 1 holes (0.00563 m²)" in warning
    assert str(found.diagnostics[0]) == warning


def test_without_small_features_nothing_is_reported() -> None:
    mesh = make_defective_sheet()
    plain = simplify(mesh, ratio=0.1)
    assert plain.dropped is None
    assert "dropped" not in plain.to_dict()
    same = simplify(mesh, ratio=0.1, drop_below=0.01)
    assert same.dropped.components == same.dropped.holes == 0
    assert same.diagnostics == plain.diagnostics
    np.testing.assert_array_equal(same.mesh.vertices, plain.mesh.vertices)
    np.testing.assert_array_equal(same.mesh.triangles, plain.mesh.triangles)


@pytest.mark.parametrize("method", METHODS, ids=lambda method: method.name)
def test_every_method_supports_drop_below(method: Method[Any, Any]) -> None:
    mesh = make_defective_sheet()
    found = simplify(mesh, drop_below=LIMIT, **make_parameters(method, mesh))
    assert (found.dropped.components, found.dropped.holes) == (3, 1)
    assert topology(found.mesh).components == 1
    assert found.triangle_source.min() >= 0
    assert found.triangle_source.max() < len(mesh.triangles)
    assert found.vertex_source.min() >= 0
    assert found.vertex_source.max() < len(mesh.vertices)


def test_sources_refer_to_the_given_mesh() -> None:
    mesh = make_defective_sheet()
    # The boxes are first, so that indices are shifted.
    mesh = mesh.with_(triangles=np.roll(mesh.triangles, 36, axis=0))
    rest = remove_small_features(mesh, LIMIT, np.zeros(len(mesh.vertices), bool))
    np.testing.assert_array_equal(rest.mesh.vertices, mesh.vertices[rest.vertex_source])
    np.testing.assert_array_equal(rest.mesh.colors, mesh.colors[rest.vertex_source])
    kept = len(rest.mesh.triangles) - rest.removal_counts.hole_triangles
    np.testing.assert_array_equal(
        rest.vertex_source[rest.mesh.triangles[:kept]], mesh.triangles[rest.triangle_source[:kept]]
    )
    # The source of a triangle in a filled hole is adjacent to it.
    for triangle, source in zip(rest.mesh.triangles[kept:], rest.triangle_source[kept:], strict=True):
        assert set(rest.vertex_source[triangle]) & set(mesh.triangles[source])


def test_hole_fillings_have_the_orientation_of_their_surroundings() -> None:
    mesh = make_defective_sheet(boxes=0)
    rest = remove_small_features(mesh, LIMIT, np.zeros(len(mesh.vertices), bool)).mesh
    a, b, c = (rest.vertices[rest.triangles[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 2] > 0).all()
    assert topology(rest).is_oriented


def test_a_locked_component_is_kept() -> None:
    mesh = make_defective_sheet()
    locked = [len(mesh.vertices) - 1]
    found = simplify(mesh, ratio=0.1, drop_below=LIMIT, lock=locked)
    assert found.dropped.components == 2
    assert (found.mesh.vertices == mesh.vertices[locked[0]]).all(axis=1).any()


def test_importance_follows_its_vertices() -> None:
    mesh = make_defective_sheet()
    mesh = mesh.with_(triangles=mesh.triangles[::-1].copy())
    importance = np.where(mesh.vertices[:, 0] < 0.5, 50.0, 1.0)
    found = simplify(mesh, ratio=0.1, drop_below=LIMIT, importance=importance)
    alone = remove_small_features(mesh, LIMIT, np.zeros(len(mesh.vertices), bool))
    target = len(found.mesh.triangles)
    expected = simplify(alone.mesh, triangles=target, importance=importance[alone.vertex_source])
    np.testing.assert_array_equal(found.mesh.vertices, expected.mesh.vertices)


def test_texture_seams_are_not_holes() -> None:
    mesh = wrapped_ball()
    # Vertices at the seam have copies, as in files with one coordinate per vertex.
    corners = mesh.triangles.reshape(-1)
    apart = mesh.with_(vertices=mesh.vertices[corners], triangles=np.arange(len(corners)).reshape(-1, 3))
    found = simplify(apart, ratio=0.3, drop_below=1.0)
    assert found.dropped.holes == found.dropped.components == 0


def test_a_limit_above_all_components_is_refused() -> None:
    with pytest.raises(UsageError, match=r"drop_below is 5 m, .* nothing would be left"):
        simplify(make_defective_sheet(), ratio=0.1, drop_below=5.0)


@pytest.mark.parametrize("value", [0.0, -1.0])
def test_a_limit_that_is_not_positive_is_refused(value: float) -> None:
    with pytest.raises(UsageError, match="drop_below"):
        simplify(make_defective_sheet(), ratio=0.1, drop_below=value)


def test_holes_that_meet_at_a_vertex_stay_open() -> None:
    mesh = sheet(noise=0.0, height=0.0)
    cell = np.floor(mesh.vertices[mesh.triangles].mean(axis=1)[:, :2] * 40)
    # Two cells that touch at a corner, and a separate one.
    gone = np.zeros(len(cell), bool)
    for at in ((5, 5), (6, 6), (20, 20)):
        gone |= (cell == at).all(axis=1)
    rest = remove_small_features(
        mesh.with_(triangles=mesh.triangles[~gone]), LIMIT, np.zeros(len(mesh.vertices), bool)
    )
    assert rest.removal_counts.holes == 1
    assert compute_areas(rest.mesh.vertices, rest.mesh.triangles).sum() == pytest.approx(1 - 2 / 1600)


def test_drop_below_reduces_the_error_of_a_room(shared_data) -> None:
    """At 1 % of the triangles, the 190 small components cause half of the error."""
    from scanloom.stages.comparing.compare import compare
    from scanloom.stages.surface.mesh_files import read_mesh

    mesh = read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")
    plain, dropped = (
        compare(mesh, simplify(mesh, ratio=0.01, **options).mesh, samples=100_000)
        for options in ({}, {"drop_below": 0.1})
    )
    assert dropped.symmetric.rms < 0.6 * plain.symmetric.rms
    assert dropped.color.rmse < 0.7 * plain.color.rmse
