"""Mesh painted by its distance from another surface."""

from __future__ import annotations

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

# Default colour range: quantile of the vertex distances. A few outliers must not compress the scale of all
# other vertices.
_FULL_SCALE_QUANTILE = 0.99


def paint_distances(
    mesh: Mesh, other: RaycastingSurface, full_scale: float | None = None
) -> tuple[Mesh, float]:
    """Paint a mesh by its vertices' distances from another surface (viridis, dark is near).

    For a normal mesh and its original, paint the original: the vertices of a normal mesh are on the original
    and would all have distance 0.

    Parameters
    ----------
    mesh : in metres; its own colours are replaced.
    other : surface built for a box around both meshes.
    full_scale : metres; this and larger distances get the last colour. Default: the 99 % quantile of the
        vertex distances.

    Returns
    -------
    The painted mesh, and the `full_scale` used.
    """
    require_opencv()
    import cv2

    distances = other.find_closest_points(mesh.vertices).distances
    if full_scale is None:
        full_scale = float(np.quantile(distances, _FULL_SCALE_QUANTILE)) if len(distances) else 0.0
    ratios = distances / max(full_scale, np.finfo(np.float64).tiny)
    levels = np.rint(255 * ratios.clip(0, 1)).astype(np.uint8)
    colors = cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return mesh.with_(colors=np.ascontiguousarray(colors), texture=None), full_scale
