"""Mean normal of an open surface: the side from which a scan saw it."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats

# Ratio of the length of the summed area vectors to the area, above which a surface was seen from one side. A
# closed surface has 0.
_ONE_SIDED_RATIO = 0.1


def estimate_mean_normal(mesh: Mesh, turn: Floats) -> list[float] | None:
    """Estimate the unit mean normal of a mesh, weighted by area.

    Parameters
    ----------
    turn : (3, 3) rotation of the result.

    Returns
    -------
    The normal, (3,), or None for a surface that faces all directions.
    """
    corners = mesh.vertices[mesh.triangles]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    toward, area = turn @ doubled.sum(axis=0), np.linalg.norm(doubled, axis=1).sum()
    length = float(np.linalg.norm(toward))
    return (toward / length).round(4).tolist() if length > _ONE_SIDED_RATIO * area else None
