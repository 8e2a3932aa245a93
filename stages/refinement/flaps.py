"""Detection of flaps: narrow surface that no frame has measured from the front.

Sensors measure false depth next to discontinuities, and fusion closes the far side of rims. Both give narrow
strips that are only seen edge-on. A road is seen edge-on, too, but it is wide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import build_edges, label_components
from scanloom.stages.surface.mesh import Triangles

# A region is wide if one of its vertices is more than this many edges from its border.
_WIDE_RINGS = 8
# Minimum cosine between normal and line of sight of a measurement from the front. A recording along its
# surfaces, such as a drive on a street, has few: at most this ratio of the measured vertices is below.
_MIN_COSINE, _MAX_OBLIQUE_RATIO = 0.2, 0.02


def mask_flaps(triangles: Triangles, best_cosines: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find the triangles of flaps.

    Parameters
    ----------
    triangles : (m, 3).
    best_cosines : (n,) largest cosine of the angle between the normal of each vertex and the line of sight of
        a frame that measured it; 0 without such a frame.

    Returns
    -------
    (m,) True for triangles whose corners all belong to a flap.
    """
    measured = best_cosines[best_cosines > 0]
    if not len(measured):
        return np.zeros(len(triangles), bool)
    is_frontal = best_cosines >= min(_MIN_COSINE, float(np.quantile(measured, _MAX_OBLIQUE_RATIO)))
    edges = build_edges(triangles, len(is_frontal))
    tails, heads = edges.ends.T
    is_oblique = ~is_frontal
    inside = is_oblique[tails] & is_oblique[heads]
    _, region = label_components(len(is_frontal), tails[inside], heads[inside])
    # Erode the regions from frontal vertices and from the boundary.
    is_eroded = is_frontal.copy()
    is_eroded[edges.ends[edges.triangle_count == 1]] = True
    for _ in range(_WIDE_RINGS):
        reached = is_eroded[tails] | is_eroded[heads]
        is_eroded[tails[reached]] = True
        is_eroded[heads[reached]] = True
    is_wide = np.zeros(int(region.max(initial=-1)) + 1, bool)
    is_wide[region[~is_eroded]] = True
    is_flap = is_oblique & ~is_wide[region]
    return np.asarray(is_flap[triangles].all(axis=1))
