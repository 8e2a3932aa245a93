"""Coordinates too large for areas and volumes give a one-sentence error in every operation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from coloured_meshes import sheet
from seamed_meshes import wrapped_ball

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.certify import certify
from scanloom.stages.comparing.compare import compare
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.normal_meshes.remesh import remesh
from scanloom.stages.rendering.render import render
from scanloom.stages.rendering.viewpoints import viewpoints
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.bake import bake

SMALL = sheet(n=5)
TEXTURED = wrapped_ball(6, 8)

ASKED: dict[str, Callable[[Mesh], Any]] = {
    "quadric": lambda mesh: simplify(mesh, method="quadric", ratio=0.5),
    "seams": lambda mesh: simplify(mesh, method="seams", ratio=0.5),
    "jia01": lambda mesh: simplify(mesh, method="jia01", ratio=0.5),
    "planar": lambda mesh: simplify(mesh, method="planar"),
    "certified": lambda mesh: simplify(mesh, method="certified", max_shape=0.01),
    "auto": lambda mesh: simplify(mesh, ratio=0.5),
    "clean": clean,
    "stitch": lambda mesh: clean(mesh, stitch=True),
    "compare": lambda mesh: compare(mesh, SMALL),
    "to compare": lambda mesh: compare(SMALL, mesh),
    "certify": lambda mesh: certify(mesh, SMALL),
    "remesh": lambda mesh: remesh(mesh, levels=1),
    "bake": lambda mesh: bake(mesh, SMALL),
    "to bake": lambda mesh: bake(SMALL, mesh),
    "render": lambda mesh: render(mesh, viewpoints(SMALL, 1, width=64)[0]),
    "viewpoints": lambda mesh: viewpoints(mesh, 1, width=64),
}


def add_spike(mesh: Mesh, far: float) -> Mesh:
    vertices = mesh.vertices.copy()
    vertices[7] = far
    return mesh.with_(vertices=vertices)


@pytest.mark.parametrize("asked", ASKED)
@pytest.mark.parametrize("far", [1e61, 1e154, -1e300])
@pytest.mark.parametrize("change", [add_spike, lambda mesh, far: mesh.with_(vertices=mesh.vertices * far)])
def test_coordinates_that_overflow_are_refused(asked: str, far: float, change: Any) -> None:
    """Formerly `seams` crashed, `compare` measured infinity, and `clean` removed such triangles."""
    with pytest.raises(MeshError, match=r"vertex \d+ .*beyond ±1e\+?60"):
        ASKED[asked](change(SMALL, far))


@pytest.mark.parametrize("asked", ["seams", "bake", "to bake", "compare", "remesh"])
@pytest.mark.parametrize("far", [1e31, 1e300])
def test_texture_coordinates_that_overflow_are_refused(asked: str, far: float) -> None:
    texture = TEXTURED.texture
    assert texture is not None
    mesh = TEXTURED.with_(texture=replace(texture, uvs=texture.uvs * far))
    with pytest.raises(MeshError, match="texture coordinates of triangle 0 are"):
        ASKED[asked](mesh)


def test_texture_coordinates_that_underflow_are_reported() -> None:
    texture = TEXTURED.texture
    assert texture is not None
    mesh = TEXTURED.with_(texture=replace(texture, uvs=texture.uvs * 1e-160))
    with pytest.raises(MeshError, match="texture coordinates are too small"):
        simplify(mesh, method="seams", ratio=0.5)


@pytest.mark.parametrize("asked", ["quadric", "seams", "clean", "certify"])
def test_large_measurable_coordinates_are_accepted(asked: str) -> None:
    ASKED[asked](SMALL.with_(vertices=SMALL.vertices * 1e40))
