"""Where a first look at a model is from."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats

# Of its area: what of a surface looks one way on balance where it was seen from one side; 0 if it is closed.
_ONE_SIDED = 0.1


def facing(mesh: Mesh, turn: Floats) -> list[float] | None:
    """Return where a surface looks that was seen from one side, by a turn (3, 3); None if all around."""
    corners = mesh.vertices[mesh.triangles]
    doubled = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    toward, area = turn @ doubled.sum(axis=0), np.linalg.norm(doubled, axis=1).sum()
    length = float(np.linalg.norm(toward))
    return (toward / length).round(4).tolist() if length > _ONE_SIDED * area else None
