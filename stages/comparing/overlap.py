"""Whether two meshes, or clouds, are where they can be of the same thing."""

from __future__ import annotations

import numpy as np

from stages.comparing.measurable import box_of
from stages.surface.mesh import Mesh


def gap_of_unrelated(a: Mesh, b: Mesh) -> float | None:
    """Return how far apart two meshes are, in metres, if that is more than the smaller one's size, else None.

    Surfaces of one thing may well not touch, as two sides of a wall do; but they are near, for their size.
    Both have triangles, or points at least.
    """
    (low_a, high_a), (low_b, high_b) = box_of(a), box_of(b)
    between = np.maximum(np.maximum(low_a - high_b, low_b - high_a), 0)
    gap = float(np.linalg.norm(between))
    sizes = (float(np.linalg.norm(high - low)) for low, high in ((low_a, high_a), (low_b, high_b)))
    return gap if gap > min(sizes) else None
