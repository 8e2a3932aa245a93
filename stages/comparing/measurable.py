"""Meshes that can be measured, of whatever is given."""

from __future__ import annotations

from stages.surface.convert import MeshLike, as_mesh
from stages.surface.mesh import Mesh
from stages.surface.topology import require_area


def measurable(given: MeshLike, called: str) -> Mesh:
    """Return a mesh that has an area.

    Raises
    ------
    MeshError
        If it has none, or is no mesh; `called` names it there.
    """
    mesh = as_mesh(given, called)
    require_area(mesh, called)
    return mesh
