"""Detection of flaps and skirts: narrow false surface next to occlusion boundaries.

Sensors measure false depth next to discontinuities, and fusion closes the far side of rims. Both give
narrow strips: flaps are only seen edge-on; through skirts, other frames have seen free space. A road is seen
edge-on, too, but it is wide.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Edges, build_edges, label_components
from scanloom.stages.surface.mesh import Triangles

# A region is wide if one of its vertices is more than this many edges from its border.
_WIDE_RINGS = 8
# Minimum cosine between normal and line of sight of a measurement from the front. A recording along its
# surfaces, such as a drive on a street, has few: at most this ratio of the measured vertices is below.
_MIN_COSINE, _MAX_OBLIQUE_RATIO = 0.2, 0.02

Mask = NDArray[np.bool_]


def mask_flaps(triangles: Triangles, best_cosines: NDArray[np.float64], is_contradicted: Mask) -> Mask:
    """Find the triangles of flaps and skirts, and the scraps that they leave.

    Parameters
    ----------
    triangles : (m, 3).
    best_cosines : (n,) largest cosine of the angle between the normal of each vertex and the line of sight of
        a frame that measured it; 0 without such a frame.
    is_contradicted : (n,) True for vertices at which more frames have seen free space than surface.

    Returns
    -------
    (m,) True for triangles whose corners all belong to a flap, or all to a skirt; and for scraps: components
    of the rest with a vertex of a flap or skirt at each triangle.
    """
    measured = best_cosines[best_cosines > 0]
    if not len(measured):
        return np.zeros(len(triangles), bool)
    is_oblique = best_cosines < min(_MIN_COSINE, float(np.quantile(measured, _MAX_OBLIQUE_RATIO)))
    edges = build_edges(triangles, len(best_cosines))
    is_rim = np.zeros(len(best_cosines), bool)
    is_rim[edges.ends[edges.triangle_count == 1]] = True
    is_flap = _find_narrow_regions(is_oblique, is_rim, edges)
    # Contradicted surface inside of other surface is no skirt: poses and moving objects contradict it, too.
    is_rim[triangles[is_flap[triangles].all(axis=1)]] = True
    is_skirt = _find_narrow_regions(is_contradicted, is_rim, edges, only_at_rim=True)
    is_false = np.asarray(is_flap[triangles].all(axis=1) | is_skirt[triangles].all(axis=1))
    return np.asarray(is_false | _find_scraps(triangles, is_flap | is_skirt, ~is_false))


def _find_narrow_regions(is_member: Mask, is_rim: Mask, edges: Edges, only_at_rim: bool = False) -> Mask:
    """Find the vertices (n,) of narrow connected regions of members.

    Parameters
    ----------
    only_at_rim : ignore regions without a vertex on the rim.
    """
    tails, heads = edges.ends.T
    inside = is_member[tails] & is_member[heads]
    _, region = label_components(len(is_member), tails[inside], heads[inside])
    # Erode the regions from the other vertices and from the rim.
    is_eroded = ~is_member | is_rim
    for _ in range(_WIDE_RINGS):
        reached = is_eroded[tails] | is_eroded[heads]
        is_eroded[tails[reached]] = True
        is_eroded[heads[reached]] = True
    is_narrow = np.ones(int(region.max(initial=-1)) + 1, bool)
    is_narrow[region[~is_eroded]] = False
    if only_at_rim:
        at_rim = np.zeros(len(is_narrow), bool)
        at_rim[region[is_member & is_rim]] = True
        is_narrow &= at_rim
    return np.asarray(is_member & is_narrow[region])


def _find_scraps(triangles: Triangles, is_false_vertex: Mask, is_left: Mask) -> Mask:
    """Find the triangles (m,) of components that have false vertices at each of their triangles."""
    left = triangles[is_left]
    tails, heads = left.ravel(), np.roll(left, -1, axis=1).ravel()
    _, component = label_components(len(is_false_vertex), tails, heads)
    is_scrap = np.ones(int(component.max(initial=-1)) + 1, bool)
    is_scrap[component[left[~is_false_vertex[left].any(axis=1), 0]]] = False
    return np.asarray(is_left & is_scrap[component[triangles[:, 0]]])
