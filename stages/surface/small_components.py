"""Detection of small connected components."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import label_components
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.welding import find_first_equal_rows


def find_small_components(
    mesh: Mesh, size: float, keep: NDArray[np.bool_] | None = None
) -> tuple[NDArray[np.bool_], int]:
    """Find the triangles of connected components smaller than a size.

    Triangles are connected if they share a vertex position. The size of a component is the diagonal of its
    bounding box.

    Parameters
    ----------
    mesh : mesh to search.
    size : limit of the diagonal, metres.
    keep : (n,) mask of vertices whose components count as large.

    Returns
    -------
    A mask (m,) of the triangles, and the number of small components.
    """
    position = find_first_equal_rows(list(mesh.vertices.T))
    corners = position[mesh.triangles]
    _, label = label_components(len(position), corners[:, :2].reshape(-1), corners[:, 1:].reshape(-1))
    _, component = np.unique(label[corners[:, 0]], return_inverse=True)
    count = int(component.max(initial=-1)) + 1
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    for corner in range(3):
        np.minimum.at(low, component, mesh.vertices[mesh.triangles[:, corner]])
        np.maximum.at(high, component, mesh.vertices[mesh.triangles[:, corner]])
    is_small = np.linalg.norm(high - low, axis=1) < size
    if keep is not None:
        is_small[component[keep[mesh.triangles].any(axis=1)]] = False
    return np.asarray(is_small[component]), int(is_small.sum())
