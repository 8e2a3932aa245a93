"""Collapse record: every intermediate mesh is sound, and the last one is the result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from partial_meshes import select_quarter

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.compare import compare
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.simplification.records.collapse_steps import ReplayedMesh
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.simplify import SimplificationResult, simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import read_mesh
from scanloom.stages.surface.topology import topology


def make_ring() -> Mesh:
    made = trimesh.creation.torus(1.0, 0.4, major_sections=48, minor_sections=24)
    vertices = np.array(made.vertices)
    colors = np.clip(128 + 90 * np.sin(5 * vertices), 0, 255).astype(np.uint8)
    return Mesh(vertices, np.array(made.faces, np.int32), colors=colors)


def make_half_ring() -> Mesh:
    """Make a ring that is open at both ends."""
    mesh = make_ring()
    kept = mesh.triangles[(mesh.vertices[mesh.triangles][:, :, 1] > 0.1).all(axis=1)]
    return clean(mesh.with_(triangles=kept)).mesh


MESHES = {"ring": make_ring, "half ring": make_half_ring}


def simplify_with_record(mesh: Mesh, **changes: Any) -> tuple[SimplificationResult, CollapseRecord]:
    result = simplify(mesh, record=True, **changes)
    assert result.record is not None
    return result, result.record


def assert_equal(
    one: SimplificationResult | ReplayedMesh, other: SimplificationResult | ReplayedMesh
) -> None:
    for name in ("vertices", "triangles", "colors", "normals"):
        np.testing.assert_array_equal(getattr(one.mesh, name), getattr(other.mesh, name))
    np.testing.assert_array_equal(one.vertex_source, other.vertex_source)
    np.testing.assert_array_equal(one.triangle_source, other.triangle_source)


BOUNDED = {
    "certified": {"max_shape": 0.02, "max_color": 20},
    "certified to a number": {"max_shape": 0.05, "triangles": 500},
    "jia01": {"method": "jia01", "max_shape": 0.03},
    "jia01 with more splits": {"method": "jia01", "max_shape": 0.03, "jia01": {"resolution": 0.07}},
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("fit", [True, False], ids=["fitted", "plain"])
def test_the_whole_record_gives_the_result(name: str, fit: bool) -> None:
    result, record = simplify_with_record(MESHES[name](), ratio=0.1, fit=fit)
    assert len(record.removed) == result.collapses
    assert_equal(record.replay(fit=fit), result)


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("how", BOUNDED)
def test_the_whole_record_gives_the_bounded_result(name: str, how: str) -> None:
    result, record = simplify_with_record(MESHES[name](), **BOUNDED[how])
    assert len(record.removed) == result.collapses > 150
    assert (getattr(result.details, "splits", 0) > 0) == how.startswith("jia01")
    assert_equal(record.replay(), result)


def test_zero_collapses_give_the_input() -> None:
    mesh = make_ring()
    _, record = simplify_with_record(mesh, ratio=0.1)
    assert_equal(record.replay(collapses=0), simplify_with_record(mesh, ratio=1.0)[0])
    np.testing.assert_array_equal(record.replay(collapses=0).mesh.vertices, mesh.vertices)


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("how", ["quadric", *BOUNDED])
def test_every_intermediate_mesh_is_sound(name: str, how: str) -> None:
    _, record = simplify_with_record(MESHES[name](), **BOUNDED.get(how, {"triangles": 1}))
    was = topology(record.mesh)
    assert len(record.removed) > (300 if how == "quadric" else 150)
    triangles = len(record.mesh.triangles)
    step = max(7, len(record.removed) // 60)
    for collapses in range(0, len(record.removed) + 1, step):
        replayed = record.replay(collapses=collapses)
        now = topology(replayed.mesh)
        assert now.is_manifold
        assert now.is_oriented
        assert (now.euler, now.boundary_loops, now.components) == (
            was.euler,
            was.boundary_loops,
            was.components,
        )
        assert now.duplicate == now.unreferenced == 0
        # A collapse removes one vertex and two triangles, or one triangle at a boundary.
        assert now.vertices == was.vertices - collapses
        assert triangles - 2 * step <= now.triangles <= triangles
        assert now.triangles == record.count_triangles_after(collapses)
        triangles = now.triangles


@pytest.mark.parametrize("name", MESHES)
def test_any_triangle_count_is_reached(name: str) -> None:
    mesh = MESHES[name]()
    result, record = simplify_with_record(mesh, triangles=100)
    before = len(mesh.triangles)
    for wanted in (before + 5, before, before - 1, before // 2, 301, 300, len(result.mesh.triangles)):
        replayed = record.replay(triangles=wanted)
        count = len(replayed.mesh.triangles)
        assert wanted - 1 <= count <= wanted or count == before < wanted
        if replayed.collapses:
            # One collapse less is not sufficient.
            assert record.count_triangles_after(replayed.collapses - 1) > wanted
    np.testing.assert_array_equal(
        record.replay(ratio=0.5).mesh.vertices, record.replay(triangles=before // 2).mesh.vertices
    )


def replay_step_by_step(record: CollapseRecord, collapses: int) -> set[tuple[tuple[float, ...], ...]]:
    """Replay the collapses one by one; return triangles as positions of their corners."""
    place = dict(enumerate(map(tuple, record.mesh.vertices.tolist())))
    triangles = [tuple(t) for t in record.mesh.triangles.tolist()]
    for removed, survivor, to in list(zip(record.removed, record.survivor, record.path, strict=True))[
        :collapses
    ]:
        triangles = [tuple(survivor if v == removed else v for v in t) for t in triangles]
        triangles = [t for t in triangles if len(set(t)) == 3]
        place[int(survivor)] = tuple(to[:3].tolist())
    return {tuple(place[int(v)] for v in t) for t in triangles}


@pytest.mark.parametrize("collapses", [1, 50, 333])
def test_a_replay_equals_single_steps(collapses: int) -> None:
    _, record = simplify_with_record(make_half_ring(), triangles=30)
    replayed = record.replay(collapses=collapses).mesh
    at_once = {tuple(map(tuple, t)) for t in replayed.vertices[replayed.triangles].tolist()}
    assert at_once == replay_step_by_step(record, collapses)


def test_sources_are_close_to_their_origin() -> None:
    mesh = make_ring()
    _, record = simplify_with_record(mesh, ratio=0.1)
    replayed = record.replay(ratio=0.5)
    apart = np.linalg.norm(replayed.mesh.vertices - mesh.vertices[replayed.vertex_source], axis=1)
    assert apart.max() < 0.2
    then = mesh.vertices[mesh.triangles[replayed.triangle_source]].mean(axis=1)
    now = replayed.mesh.vertices[replayed.mesh.triangles].mean(axis=1)
    assert np.linalg.norm(now - then, axis=1).max() < 0.4


def test_a_fitted_replay_is_closer() -> None:
    mesh = make_ring()
    _, record = simplify_with_record(mesh, triangles=50)
    plain, fitted = (record.replay(triangles=300, fit=fit).mesh for fit in (False, True))
    np.testing.assert_array_equal(plain.triangles, fitted.triangles)
    rms = [compare(mesh, light, samples=20_000).symmetric.rms for light in (plain, fitted)]
    assert rms[1] < rms[0]


def test_locked_vertices_are_kept_in_every_replay() -> None:
    mesh = make_ring()
    lock = np.arange(0, len(mesh.vertices), 9)
    _, record = simplify_with_record(mesh, ratio=0.4, lock=lock)
    assert mesh.colors is not None
    for ratio in (0.8, 0.4):
        replayed = record.replay(ratio=ratio, fit=True)
        at = np.searchsorted(replayed.vertex_source, lock)
        assert replayed.mesh.colors is not None
        np.testing.assert_array_equal(replayed.vertex_source[at], lock)
        np.testing.assert_array_equal(replayed.mesh.vertices[at], mesh.vertices[lock])
        np.testing.assert_array_equal(replayed.mesh.colors[at], mesh.colors[lock])


def test_undone_collapses_are_not_in_the_record(shared_data: Path) -> None:
    kitchen = read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")
    mesh = clean(select_quarter(kitchen)).mesh
    result, record = simplify_with_record(mesh, max_shape=0.005, max_color=20)
    assert result.details.iterations is not None
    assert result.details.iterations > 3
    assert len(record.removed) == result.collapses
    assert_equal(record.replay(), result)
    was = topology(mesh)
    for ratio in (0.6, 0.3, 0.15):
        now = topology(record.replay(ratio=ratio).mesh)
        assert now.is_manifold
        assert (now.euler, now.boundary_loops) == (was.euler, was.boundary_loops)


def test_a_scan_of_several_regions_replays(shared_data: Path) -> None:
    mesh = clean(read_mesh(shared_data / "meshes" / "redkitchen_fused_vertexcolor.ply")).mesh
    result, record = simplify_with_record(mesh, ratio=0.05)
    assert_equal(record.replay(fit=True), result)
    was = topology(mesh)
    for ratio in (0.7, 0.3, 0.1):
        now = topology(record.replay(ratio=ratio).mesh)
        assert now.is_manifold
        assert (now.euler, now.boundary_loops) == (was.euler, was.boundary_loops)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"triangles": 100, "ratio": 0.5}, "triangles and ratio are given"),
        ({"collapses": 10**6}, "collapses is 1000000, but the record holds only"),
        ({"triangles": 3}, "triangles asks for 3 triangles, but the record ends at 230"),
        ({"ratio": 0.001}, "ratio asks for 2 triangles, but the record ends at 230"),
        ({"collapses": -1}, "at least 0"),
        ({"count": 5}, "unknown parameter 'count'"),
    ],
)
def test_counts_outside_the_record_are_refused(changes: dict[str, Any], message: str) -> None:
    _, record = simplify_with_record(make_ring(), triangles=230)
    with pytest.raises(UsageError, match=message):
        record.replay(**changes)


def test_a_mesh_that_cannot_be_fitted_is_reported() -> None:
    """Such a record can only come from a foreign file."""
    _, record = simplify_with_record(make_ring(), triangles=300)
    triangles = record.mesh.triangles.copy()
    triangles[0] = triangles[0, ::-1]
    with pytest.raises(MeshError, match="the mesh of the record cannot be fitted: "):
        replace(record, mesh=record.mesh.with_(triangles=triangles)).replay(collapses=0, fit=True)
