"""Tangential Laplacian of the paper: its formula for each vertex, and its effect on normal meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coloured_meshes import ball, sheet
from numpy.typing import NDArray

from scanloom import Mesh, compare, read_mesh
from scanloom.stages.normal_meshes.normal_mesh import decode
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.normal_meshes.tangential_laplacian import relax_tangentially


def relax_vertex_by_vertex(mesh: Mesh) -> NDArray[np.float64]:
    """Compute the vertices after one step, by equations (2) to (4) for each vertex."""
    found = mesh.vertices.copy()
    for v in range(len(mesh.vertices)):
        around = mesh.triangles[(mesh.triangles == v).any(axis=1)]
        others, count = np.unique(around[around != v], return_counts=True)
        if (count == 1).any():
            # A neighbour in only one triangle makes the vertex a boundary vertex.
            continue
        laplacian = np.mean(mesh.vertices[others] - mesh.vertices[v], axis=0)
        a, b, c = (mesh.vertices[around[:, k]] for k in range(3))
        normal = np.cross(b - a, c - a).sum(axis=0)
        normal /= np.linalg.norm(normal)
        found[v] += laplacian - (laplacian @ normal) * normal
    return found


@pytest.mark.parametrize("mesh", [sheet(8), ball()], ids=["open", "closed"])
def test_a_step_follows_the_papers_formula(mesh: Mesh) -> None:
    random = np.random.default_rng(0)
    uneven = mesh.with_(vertices=mesh.vertices + random.normal(scale=0.01, size=mesh.vertices.shape))
    relaxed = relax_tangentially(uneven)
    expected = relax_vertex_by_vertex(uneven)
    np.testing.assert_allclose(relaxed.vertices, expected, atol=1e-12)
    assert np.abs(relaxed.vertices - uneven.vertices).max() > 1e-3
    np.testing.assert_array_equal(relaxed.triangles, uneven.triangles)
    np.testing.assert_allclose(
        relax_tangentially(uneven, 2).vertices,
        relax_vertex_by_vertex(uneven.with_(vertices=expected)),
        atol=1e-12,
    )


def measure_min_angles(mesh: Mesh) -> NDArray[np.float64]:
    """Measure the smallest angle of each triangle, degrees."""
    corners = mesh.vertices[mesh.triangles]
    angles = []
    for k in range(3):
        one, other = corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k]
        lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(other, axis=1)
        angles.append(np.degrees(np.arccos(np.einsum("ij,ij->i", one, other) / lengths)))
    return np.min(angles, axis=0)


def test_triangles_become_more_regular_and_the_file_stays_the_same(tmp_path: Path) -> None:
    """As in figure 5 of the paper, without the relaxation of new vertices."""
    mesh = ball()
    plain = remesh(mesh, base_triangles=60, levels=3, relaxations=0)
    relaxed = remesh(mesh, base_triangles=60, levels=3, relaxations=0, tangential_steps=3)
    before, after = measure_min_angles(plain.mesh), measure_min_angles(relaxed.mesh)
    assert after.mean() > before.mean() + 2
    assert np.percentile(after, 5) > np.percentile(before, 5) + 2
    # The tangential part does not shrink the ball, but moves vertices slightly off the surface.
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    assert compare(mesh, relaxed.mesh, samples=5000).symmetric.maximum < 0.02 * diagonal
    # Levels and file do not contain these steps.
    assert relaxed.data == plain.data
    np.testing.assert_array_equal(relaxed.levels[-1].vertices, plain.mesh.vertices)
    np.testing.assert_array_equal(decode(relaxed.data).mesh.vertices, plain.mesh.vertices)
    relaxed.write(tmp_path / "relaxed.ply")
    np.testing.assert_allclose(
        read_mesh(tmp_path / "relaxed.ply").vertices, relaxed.mesh.vertices, atol=1e-6 * diagonal
    )
