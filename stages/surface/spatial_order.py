"""Reordering of meshes for memory locality."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh import Mesh

Rows = NDArray[np.integer[Any]]

# Vertices. Smaller meshes fit in the CPU caches in any order.
_MIN_VERTICES = 100_000

# Sampled triangles, and the maximum index distance between neighbours as a ratio of the vertex count.
_SAMPLE_COUNT = 4096
_MAX_INDEX_DISTANCE_RATIO = 1 / 64


def is_scattered(mesh: Mesh) -> bool:
    """Return True if neighbours in a large mesh are mostly far apart in memory."""
    triangles = mesh.triangles
    if len(mesh.vertices) < _MIN_VERTICES or len(triangles) < 2:
        return False
    step = max(len(triangles) // _SAMPLE_COUNT, 1)
    here = triangles[:-1:step]
    following = triangles[1::step]
    apart = np.maximum(np.ptp(here, axis=1), abs(following[:, 0] - here[:, 0]))
    return bool(np.median(apart) > _MAX_INDEX_DISTANCE_RATIO * len(mesh.vertices))


@dataclass(frozen=True, eq=False)
class ReorderedMesh:
    """A mesh reordered so that neighbours in space are neighbours in memory.

    Attributes
    ----------
    mesh : the reordered mesh.
    vertex_source : (n,) uint32, input vertex of each vertex.
    triangle_source : (m,) uint32, input triangle of each triangle.
    """

    mesh: Mesh
    vertex_source: Rows
    triangle_source: Rows


def reorder_spatially(mesh: Mesh) -> ReorderedMesh:
    """Reorder a mesh along a space-filling curve.

    Raises
    ------
    InvalidMeshError
        If an index is out of range or a value is not finite.
    """
    vertices, triangles = _kernels.compute_spatial_order(mesh.vertices, mesh.triangles)
    return ReorderedMesh(permute_rows(mesh, vertices, triangles), vertices, triangles)


def permute_rows(mesh: Mesh, vertices: Rows, triangles: Rows) -> Mesh:
    """Return the mesh with permuted vertices (n,) and triangles (m,)."""
    # `take` is several times faster than indexing.
    number = np.empty(len(vertices), np.int32)
    number[vertices] = np.arange(len(vertices), dtype=np.int32)
    return mesh.with_triangles(number.take(mesh.triangles.take(triangles, axis=0)), triangles).with_(
        vertices=mesh.vertices.take(vertices, axis=0),
        colors=None if mesh.colors is None else mesh.colors.take(vertices, axis=0),
        normals=None if mesh.normals is None else mesh.normals.take(vertices, axis=0),
    )
