"""Collision parts inside of an object, checked by Boolean operations of manifold3d."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from coloured_sheet import textured_sheet

from scanloom import Mesh, export_simulation
from scanloom.stages.exporting.simulation.collision_proof import SolidDistance
from scanloom.stages.exporting.simulation.convex_part import ConvexPart, build_part
from scanloom.stages.exporting.simulation.decomposition import MAX_CORNERS
from scanloom.stages.exporting.simulation.inner_parts import carve_parts, is_inside
from scanloom.stages.surface.raycasting import compute_triangle_normals

manifold3d = pytest.importorskip("manifold3d")


def to_manifold(vertices: np.ndarray, triangles: np.ndarray) -> Any:
    mesh = manifold3d.Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(triangles, np.uint64))
    return manifold3d.Manifold(mesh)


def make_ring() -> Mesh:
    made = trimesh.creation.torus(0.1, 0.03, major_sections=24, minor_sections=12)
    return Mesh(np.array(made.vertices), np.array(made.faces, np.int32), up=(0.0, 0.0, 1.0))


def make_sector(angle: float, width: float = 0.6) -> ConvexPart:
    """Make the hull of a sector of the ring, which reaches out of the ring in the hole."""
    mesh = make_ring()
    directions = np.arctan2(mesh.vertices[:, 1], mesh.vertices[:, 0])
    near = np.abs((directions - angle + np.pi) % (2 * np.pi) - np.pi) <= width
    return build_part(mesh.vertices[near])


def measure_outside(parts: list[ConvexPart], mesh: Mesh) -> float:
    """Measure the volume of parts outside of a mesh."""
    solid = to_manifold(mesh.vertices, mesh.triangles)
    return sum((to_manifold(part.vertices, part.triangles) - solid).volume() for part in parts)


def test_carved_parts_are_inside() -> None:
    mesh = make_ring()
    hulls = [make_sector(angle) for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False)]
    assert measure_outside(hulls, mesh) > 1e-5
    parts = carve_parts(hulls, mesh, 0.005)
    assert len(parts) == len(hulls)
    assert measure_outside(parts, mesh) == 0
    assert max(len(part.vertices) for part in parts) <= MAX_CORNERS
    # They still fill most of the ring.
    solid = to_manifold(mesh.vertices, mesh.triangles)
    union = manifold3d.Manifold.batch_boolean(
        [to_manifold(part.vertices, part.triangles) for part in parts], manifold3d.OpType.Add
    )
    assert union.volume() > 0.8 * solid.volume()


def test_crossing_and_outer_parts_are_not_inside() -> None:
    mesh = make_ring()
    solid = SolidDistance(mesh, is_solid=True)
    normals = compute_triangle_normals(mesh)
    cube = np.array(trimesh.creation.box((0.02, 0.02, 0.02)).vertices)
    inner = build_part(cube + np.array([0.1, 0, 0]))
    assert is_inside(inner, solid, normals, 0.0)
    # In the hole, across the surface, and around a part of the ring.
    for other in (cube, cube + np.array([0.125, 0, 0]), 8 * cube + np.array([0.1, 0, 0])):
        assert not is_inside(build_part(other), solid, normals, 0.0)
    assert carve_parts([build_part(cube)], mesh, 0.005) == []


def test_export_inside_states_the_gap(tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    pytest.importorskip("pxr")
    mesh = make_ring()
    result = export_simulation(mesh, tmp_path / "a", collision="inside", max_excess=0.01)
    (body,) = result.bodies
    assert [one.code for one in result.diagnostics] in ([], ["export.collision-large"])
    assert body.proof.excess_m == 0
    assert 0 < body.proof.attained_gap_m <= body.proof.gap_m <= 0.01
    assert measure_outside(list(body.parts), mesh) == 0
    samples = trimesh.sample.sample_surface(trimesh.Trimesh(mesh.vertices, mesh.triangles), 2000, seed=1)[0]
    heights = np.min([part.compute_heights(samples) for part in body.parts], axis=0)
    # The height above a face is at most the distance.
    assert heights.max() <= body.proof.gap_m


def test_an_open_mesh_has_no_inside(tmp_path: Path) -> None:
    pytest.importorskip("coacd")
    pytest.importorskip("pxr")
    mesh = textured_sheet(20)
    mesh = mesh.with_(vertices=mesh.vertices * (1, 1, 0), up=(0.0, 0.0, 1.0))
    result = export_simulation(mesh, tmp_path / "a", collision="inside", max_excess=0.1)
    assert [one.code for one in result.diagnostics] == ["export.open-body"] * 2
    assert "has no inside" in result.diagnostics[0].message
    assert result.bodies[0].proof.gap_m == 0
