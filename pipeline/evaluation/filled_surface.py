"""Filled holes of the refined mesh in a signal colour."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.projection import project
from scanloom.stages.inspecting.coverage.defect_kinds import DEFECT_KINDS, WELL_OBSERVED_COLOR
from scanloom.stages.rendering.viewpoints import Viewpoint
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.vertex_normals import compute_vertex_normals

FILLED_PICTURE = "refined-filled.png"
# As in `coverage`, which reports filled holes as unmeasured.
_KIND = DEFECT_KINDS["unmeasured"]
FILLED_CAPTION = f"filled holes: {_KIND.color_name}"
FILLED_COLORS = (WELL_OBSERVED_COLOR, _KIND.color)


def mark_filled_surface(mesh: Mesh, is_filled: NDArray[np.bool_]) -> Mesh:
    """Return the mesh in grey, with filled holes up to their rims in a signal colour.

    Parameters
    ----------
    is_filled : (n,) True for the vertices inside of filled holes.
    """
    colors = np.full((len(mesh.vertices), 3), FILLED_COLORS[0], np.uint8)
    colors[mesh.triangles[is_filled[mesh.triangles].any(axis=1)]] = FILLED_COLORS[1]
    return mesh.with_(colors=colors)


def choose_filled_viewpoint(
    mesh: Mesh, is_filled: NDArray[np.bool_], viewpoints: Sequence[Viewpoint]
) -> Viewpoint:
    """Choose the viewpoint that most filled vertices face; occlusion is ignored."""
    points, normals = mesh.vertices[is_filled], compute_vertex_normals(mesh)[is_filled]
    counts = []
    for viewpoint in viewpoints:
        pose, camera = viewpoint.world_from_camera, viewpoint.camera
        rays = points - pose[:3, 3]
        columns, rows = project(rays @ pose[:3, :3], camera)
        with np.errstate(invalid="ignore"):
            is_inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
        counts.append(np.count_nonzero(is_inside & ((rays * normals).sum(axis=1) < 0)))
    return viewpoints[int(np.argmax(counts))]
