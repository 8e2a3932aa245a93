"""Each function of meshes refuses or survives coordinates without extent, and beyond floating point."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest

import scanloom
from scanloom import Mesh
from scanloom.stages import lod
from scanloom.stages.diagnostics.errors import ScanloomError

TRIANGLES = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)], np.int32)
TETRAHEDRON = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1.0)])
# Three triangles with a common edge: the mesh is split into sheets first.
FAN = np.array([(0, 1, 2), (0, 1, 3), (0, 1, 4)], np.int32)
FAR = TETRAHEDRON.copy()
FAR[3] = 1e308
MESHES = {
    "point": (0 * TETRAHEDRON, TRIANGLES),
    "fan at a point": (np.zeros((5, 3)), FAN),
    "line": (TETRAHEDRON * (1, 0, 0), TRIANGLES),
    "far corner": (FAR, TRIANGLES),
    "large": (TETRAHEDRON * 1e200, TRIANGLES),
    "small": (TETRAHEDRON * 1e-300, TRIANGLES),
    "far away": (TETRAHEDRON + 1e30, TRIANGLES),
}
FUNCTIONS: dict[str, Callable[[Mesh], Any]] = {
    "check": scanloom.check,
    "clean": scanloom.clean,
    "repair": scanloom.repair,
    **{
        f"simplify {method}": lambda mesh, method=method: scanloom.simplify(mesh, ratio=0.5, method=method)
        for method in ("quadric", "seams", "jia01")
    },
    "simplify certified": lambda mesh: scanloom.simplify(mesh, max_shape=0.1),
    "simplify planar": lambda mesh: scanloom.simplify(mesh, method="planar"),
    "planar_patches": scanloom.planar_patches,
    "compare": lambda mesh: scanloom.compare(mesh, mesh),
    "deviations": lambda mesh: scanloom.deviations(mesh, mesh),
    "certify": lambda mesh: scanloom.certify(mesh, mesh),
    "remesh": scanloom.remesh,
    "lod.build": lod.build,
    "render": lambda mesh: scanloom.render(mesh, scanloom.viewpoints(mesh, 1)[0]),
}


@pytest.mark.parametrize("mesh", MESHES)
@pytest.mark.parametrize("function", FUNCTIONS)
@pytest.mark.filterwarnings("ignore")
def test_absurd_coordinates_give_a_result_or_one_error(function: str, mesh: str) -> None:
    with suppress(ScanloomError):
        FUNCTIONS[function](Mesh(*MESHES[mesh]))
