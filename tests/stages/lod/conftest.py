"""Level-of-detail hierarchies shared by several tests, built once."""

from __future__ import annotations

from functools import cache

import pytest

from scanloom.stages import Mesh, lod
from tests.made.coloured_meshes import ball, ring, sheet

MESHES = {"ball": ball, "ring": ring, "sheet": lambda: sheet(50)}


@cache
def build_cached(name: str) -> tuple[Mesh, lod.Hierarchy]:
    """Build a mesh and its hierarchy."""
    mesh = MESHES[name]()
    return mesh, lod.build(mesh, cell_triangles=600, root_triangles=100)


@pytest.fixture(params=list(MESHES))
def built(request: pytest.FixtureRequest) -> tuple[Mesh, lod.Hierarchy]:
    """Build a closed or open mesh, and its hierarchy of several cells and levels."""
    return build_cached(request.param)


@pytest.fixture
def hierarchy() -> lod.Hierarchy:
    """Build the hierarchy of a coloured ring."""
    return build_cached("ring")[1]
