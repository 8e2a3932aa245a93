"""Simplifying a mesh in an order that suits the caches, with a result in the order of the input."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from stages.simplification.result import Simplified
from stages.surface.mesh import Mesh
from stages.surface.spatial_order import Rows, ordered, with_rows


def reordered(mesh: Mesh, run: Callable[[Mesh, Rows], Simplified]) -> Simplified:
    """Return what `run` makes of the mesh in another order, with rows and sources as of the mesh itself.

    Parameters
    ----------
    run : is given the mesh in that order, and the vertex (n,) of the input that each vertex of it is.
    """
    order = ordered(mesh)
    found = run(order.mesh, order.vertices)
    sources = order.vertices[found.vertex_source], order.triangles[found.triangle_source]
    # Several vertices can have one source.
    vertices, triangles = (np.argsort(source, kind="stable") for source in sources)
    return replace(
        found,
        mesh=with_rows(found.mesh, vertices, triangles),
        vertex_source=sources[0][vertices].astype(np.int32),
        triangle_source=sources[1][triangles].astype(np.int32),
    )
