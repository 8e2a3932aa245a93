"""Pieces of a mesh that are too small to keep: no two-sided bound lets a level go without them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from stages.surface.edges import components
from stages.surface.mesh import Mesh
from stages.surface.welding import same_rows


def is_island(mesh: Mesh, size: float) -> tuple[NDArray[np.bool_], int]:
    """Return which triangles (m,) are of pieces smaller than a size, and how many such pieces there are.

    A piece is what hangs together at vertices in one place; its size is the diagonal of its bounding box.

    Parameters
    ----------
    size : metres.
    """
    place = same_rows(list(mesh.vertices.T))
    corners = place[mesh.triangles]
    _, label = components(len(place), corners[:, :2].reshape(-1), corners[:, 1:].reshape(-1))
    _, piece = np.unique(label[corners[:, 0]], return_inverse=True)
    count = int(piece.max(initial=-1)) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in range(3):
        np.minimum.at(low, piece, mesh.vertices[mesh.triangles[:, corner]])
        np.maximum.at(high, piece, mesh.vertices[mesh.triangles[:, corner]])
    is_small = np.linalg.norm(high - low, axis=1) < size
    return np.asarray(is_small[piece]), int(is_small.sum())
