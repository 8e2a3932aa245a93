"""Parts of real meshes, for tests that whole meshes would slow down."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.mesh import Mesh


def select_quarter(mesh: Mesh) -> Mesh:
    """Select the triangles of one corner: below the medians along the two longest sides."""
    middles = mesh.vertices[mesh.triangles].mean(axis=1)
    longest = np.argsort(np.ptp(mesh.vertices, axis=0))[1:]
    is_in = (middles[:, longest] < np.median(middles[:, longest], axis=0)).all(axis=1)
    used, triangles = np.unique(mesh.triangles[is_in], return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32), colors)
