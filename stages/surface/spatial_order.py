"""Meshes whose rows come in no order, for algorithms that go from neighbour to neighbour in memory."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh import Mesh

Rows = NDArray[np.integer[Any]]

# Smaller meshes fit into the caches in any order.
_LEAST_VERTICES = 100_000

# Triangles looked at, and what share of all vertices may lie between two that belong together.
_SAMPLE = 4096
_NEAR = 1 / 64


def is_scattered(mesh: Mesh) -> bool:
    """Return whether, in a large mesh, what belongs together is mostly far apart in memory."""
    triangles = mesh.triangles
    if len(mesh.vertices) < _LEAST_VERTICES or len(triangles) < 2:
        return False
    step = max(len(triangles) // _SAMPLE, 1)
    here = triangles[:-1:step]
    following = triangles[1::step]
    apart = np.maximum(np.ptp(here, axis=1), abs(following[:, 0] - here[:, 0]))
    return bool(np.median(apart) > _NEAR * len(mesh.vertices))


@dataclass(frozen=True, eq=False)
class Ordered:
    """A mesh in an order in which neighbours in space are neighbours in memory.

    Attributes
    ----------
    mesh : its rows in this order.
    vertices : (n,) uint32, the vertex of the input that each one is.
    triangles : (m,) uint32, likewise.
    """

    mesh: Mesh
    vertices: Rows
    triangles: Rows


def ordered(mesh: Mesh) -> Ordered:
    """Return the mesh in an order along a curve through space.

    Raises
    ------
    InvalidMeshError
        For an index out of range or a value that is not finite.
    """
    vertices, triangles = _kernels.spatial_order(mesh.vertices, mesh.triangles)
    return Ordered(with_rows(mesh, vertices, triangles), vertices, triangles)


def with_rows(mesh: Mesh, vertices: Rows, triangles: Rows) -> Mesh:
    """Return the mesh with its vertices (n,) and triangles (m,) in another order, each once."""
    # take is several times as fast as brackets.
    number = np.empty(len(vertices), np.int32)
    number[vertices] = np.arange(len(vertices), dtype=np.int32)
    return mesh.with_triangles(number.take(mesh.triangles.take(triangles, axis=0)), triangles).with_(
        vertices=mesh.vertices.take(vertices, axis=0),
        colors=None if mesh.colors is None else mesh.colors.take(vertices, axis=0),
        normals=None if mesh.normals is None else mesh.normals.take(vertices, axis=0),
    )
