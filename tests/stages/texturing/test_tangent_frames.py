"""Tangent frames follow MikkTSpace, by comparison with its definition written triangle by triangle."""

import math

import numpy as np
import pytest
from coloured_meshes import sheet

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.vertex_normals import compute_vertex_normals
from scanloom.stages.texturing.tangent_frames import compute_tangent_frames


def compute_reference(positions: np.ndarray, normals: np.ndarray, uvs: np.ndarray) -> np.ndarray:
    """Compute tangents (m, 3, 3) by walking around each corner over shared sides, as MikkTSpace does."""
    count = len(positions)
    keys = [
        [tuple(np.float32([*positions[t, c], *normals[t, c], *uvs[t, c]])) for c in range(3)]
        for t in range(count)
    ]
    faces, orientations = [], []
    for t in range(count):
        d1, d2 = positions[t, 1] - positions[t, 0], positions[t, 2] - positions[t, 0]
        (u1, v1), (u2, v2) = uvs[t, 1] - uvs[t, 0], uvs[t, 2] - uvs[t, 0]
        sign = 1.0 if u1 * v2 - u2 * v1 > 0 else -1.0
        tangent = sign * (v2 * d1 - v1 * d2)
        faces.append(tangent / np.linalg.norm(tangent))
        orientations.append(sign)
    sides: dict[tuple, list[tuple[int, int]]] = {}
    for t in range(count):
        for c in range(3):
            sides.setdefault((keys[t][c], keys[t][(c + 1) % 3]), []).append((t, c))

    def find_neighbours(t: int, c: int) -> list[tuple[int, int]]:
        """Find the corners at the same vertex, across the two sides of a corner."""
        before = (c + 2) % 3
        across = (
            sides.get((keys[t][(c + 1) % 3], keys[t][c]), []),
            sides.get((keys[t][c], keys[t][before]), []),
        )
        found = [(other, (start + 1) % 3) for other, start in across[0]] + list(across[1])
        return [one for one in found if orientations[one[0]] == orientations[t]]

    tangents = np.zeros((count, 3, 3))
    for t in range(count):
        for c in range(3):
            group, waiting = {(t, c)}, [(t, c)]
            while waiting:
                for one in find_neighbours(*waiting.pop()):
                    if one not in group:
                        group.add(one)
                        waiting.append(one)
            total = np.zeros(3)
            for other, corner in group:
                normal = normals[other, corner]
                here = positions[other, corner]
                flat = faces[other] - normal * (normal @ faces[other])
                directions = []
                for step in (1, 2):
                    along = positions[other, (corner + step) % 3] - here
                    along = along - normal * (normal @ along)
                    directions.append(along / np.linalg.norm(along))
                angle = math.acos(np.clip(directions[0] @ directions[1], -1, 1))
                total += angle * flat / np.linalg.norm(flat)
            tangents[t, c] = total / np.linalg.norm(total)
    return tangents


def make_bowtie() -> tuple[Mesh, np.ndarray]:
    """Make two triangles that touch at a vertex with the same normal and texture coordinates."""
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0.3, 1, 0.2], [-1, 0.1, 0], [-0.2, -1, 0.1]], float)
    triangles = np.array([[0, 1, 2], [0, 3, 4]], np.int32)
    mesh = Mesh(vertices, triangles, normals=np.tile([0.0, 0.0, 1.0], (5, 1)))
    at = np.array([[0.5, 0.5], [1, 0.5], [0.5, 1], [0.1, 0.2], [0.6, 0]])
    return mesh, at[triangles]


def make_mirrored_sheet() -> tuple[Mesh, np.ndarray]:
    """Make a curved sheet whose texture coordinates are mirrored in the middle."""
    mesh = sheet(n=8)
    mesh = mesh.with_(normals=compute_vertex_normals(mesh))
    at = mesh.vertices[:, :2].copy()
    at[:, 0] = np.abs(at[:, 0] - at[:, 0].mean()) + 0.1 * at[:, 1]
    return mesh, at[mesh.triangles]


def make_charts() -> tuple[Mesh, np.ndarray]:
    """Make a curved sheet with a chart per triangle pair, each turned differently."""
    mesh = sheet(n=6)
    mesh = mesh.with_(normals=compute_vertex_normals(mesh))
    uvs = mesh.vertices[mesh.triangles][:, :, :2].copy()
    for number in range(len(uvs)):
        angle = 0.7 * (number // 2)
        uvs[number] = uvs[number] @ [[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]]
    return mesh, uvs


@pytest.mark.parametrize("make", [make_bowtie, make_mirrored_sheet, make_charts])
def test_tangents_follow_mikktspace(make):
    mesh, uvs = make()
    frames = compute_tangent_frames(mesh, uvs)
    expected = compute_reference(mesh.vertices[mesh.triangles], mesh.normals[mesh.triangles], uvs)
    assert np.abs(frames.tangents - expected).max() < 1e-5
    assert set(np.unique(frames.signs)) <= {-1.0, 1.0}


def test_mirrored_charts_have_opposite_bitangents():
    mesh, uvs = make_mirrored_sheet()
    frames = compute_tangent_frames(mesh, uvs)
    assert (frames.signs == 1).any()
    assert (frames.signs == -1).any()
    centre = np.full((len(mesh.triangles), 3), 1 / 3)
    _, bitangents, _ = frames.interpolate(np.arange(len(mesh.triangles)), centre)
    # v grows along y on both sides of the mirror.
    assert (bitangents[:, 1] > 0.8).all()
