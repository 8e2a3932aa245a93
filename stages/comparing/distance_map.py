"""A mesh painted with how far it is from another one."""

from __future__ import annotations

import numpy as np

from scanloom.stages._opencv import require_opencv
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface

# By default, this share of the vertices is nearer than what the last colour stands for: a few that are far
# off must not make all the others look alike.
_WITHIN = 0.99


def distance_map(mesh: Mesh, other: Surface, full_scale: float | None = None) -> tuple[Mesh, float]:
    """Return a mesh in the colours of its vertices' distances from another surface, dark for near.

    Of a normal mesh and its original, paint the original: the vertices of a normal mesh lie on it, and would
    show no distance at all.

    Parameters
    ----------
    mesh : in metres; its own colours are replaced.
    other : of a box that holds both.
    full_scale : metres, what the last colour stands for, and all that is farther. Default: what 99 % of the
        vertices are within.

    Returns
    -------
    The painted mesh, and `full_scale` as it was used.
    """
    require_opencv()
    import cv2

    distances = other.closest(mesh.vertices).distances
    if full_scale is None:
        full_scale = float(np.quantile(distances, _WITHIN)) if len(distances) else 0.0
    shares = distances / max(full_scale, np.finfo(np.float64).tiny)
    levels = np.rint(255 * shares.clip(0, 1)).astype(np.uint8)
    colors = cv2.applyColorMap(levels[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]
    return mesh.with_(colors=np.ascontiguousarray(colors), texture=None), full_scale
