"""Hierarchies that several tests look at, built once."""

from __future__ import annotations

from functools import cache

import pytest

from scanloom.stages import Mesh, lod
from tests.made.coloured_meshes import ball, ring, sheet

MESHES = {"ball": ball, "ring": ring, "sheet": lambda: sheet(50)}


@cache
def built_of(name: str) -> tuple[Mesh, lod.Hierarchy]:
    """Return a mesh and its hierarchy."""
    mesh = MESHES[name]()
    return mesh, lod.build(mesh, cell_triangles=600, root_triangles=100)


@pytest.fixture(params=list(MESHES))
def built(request: pytest.FixtureRequest) -> tuple[Mesh, lod.Hierarchy]:
    """Return a mesh, closed or open, and its hierarchy of several cells and levels."""
    return built_of(request.param)


@pytest.fixture
def hierarchy() -> lod.Hierarchy:
    """Return the hierarchy of a coloured ring."""
    return built_of("ring")[1]
