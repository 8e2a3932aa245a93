"""Whether two meshes are where they can be of the same thing."""

from __future__ import annotations

import numpy as np

from stages.surface.mesh import Mesh
from stages.surface.raycasting import bounding_box


def gap_of_unrelated(a: Mesh, b: Mesh) -> float | None:
    """Return how far apart two meshes are, in metres, if that is more than the smaller one's size, else None.

    Surfaces of one thing may well not touch, as two sides of a wall do; but they are near, for their size.
    Both have triangles.
    """
    (low_a, high_a), (low_b, high_b) = bounding_box(a), bounding_box(b)
    between = np.maximum(np.maximum(low_a - high_b, low_b - high_a), 0)
    gap = float(np.linalg.norm(between))
    sizes = (float(np.linalg.norm(high - low)) for low, high in ((low_a, high_a), (low_b, high_b)))
    return gap if gap > min(sizes) else None
