"""A mesh in colours of what is missing: what was hardly seen, and beside it what would close its holes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from stages.inspecting.coverage.kinds import KINDS, THIN, WELL
from stages.inspecting.coverage.views import Floats
from stages.surface.mesh import Mesh

# How dark it is where no light falls, and where that comes from: viewers may have none.
_AMBIENT, _LIGHT = 0.6, np.array((0.35, 0.55, 0.75)) / np.linalg.norm((0.35, 0.55, 0.75))


def painted(mesh: Mesh, normals: Floats, kinds: NDArray[np.int8], caps: Sequence[tuple[str, Floats]]) -> Mesh:
    """Return the mesh, and behind its triangles those of the caps, each in the colour of its kind.

    Parameters
    ----------
    normals : (n, 3) of the vertices.
    kinds : (n,) which of THIN each vertex is, -1 for none.
    caps : kind and corners (k, 3, 3), metres, of what would close holes.
    """
    palette = np.array([*(KINDS[kind].color for kind in THIN), WELL], np.float64)
    light = _AMBIENT + (1 - _AMBIENT) * np.abs(normals @ _LIGHT)
    vertices, colors = [mesh.vertices], [palette[kinds] * light[:, None]]
    triangles, count = [mesh.triangles], len(mesh.vertices)
    for kind, corners in caps:
        vertices.append(corners.reshape(-1, 3))
        triangles.append((count + np.arange(3 * len(corners))).reshape(-1, 3).astype(np.int32))
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), np.finfo(np.float64).tiny)
        shade = _AMBIENT + (1 - _AMBIENT) * np.abs(across @ _LIGHT)
        colors.append(np.repeat(np.array(KINDS[kind].color) * shade[:, None], 3, axis=0))
        count += 3 * len(corners)
    return Mesh(
        np.concatenate(vertices),
        np.concatenate(triangles),
        np.rint(np.concatenate(colors)).astype(np.uint8),
        up=mesh.up,
    )
