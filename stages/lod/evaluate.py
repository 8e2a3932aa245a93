"""View-dependent evaluation of a hierarchy, and adjustment of its front."""

from __future__ import annotations

import heapq

import numpy as np

from scanloom.stages.lod import measures
from scanloom.stages.lod.front import Front, Region
from scanloom.stages.lod.levels import Levels
from scanloom.stages.lod.measures import Rule, Weights
from scanloom.stages.lod.view import View


def evaluate(
    hierarchy: Levels, view: View, region: Region | None = None, *, rule: Rule = "corrected"
) -> Weights:
    """Compute the refinement priority of each node (Wang, Lu and Pan 2012, section 2.2).

    The error is the proven error of the node's coarse mesh, in pixels of the view.

    Parameters
    ----------
    hierarchy : levels to evaluate.
    view : view that determines visibility and pixel size.
    region : vertices inside count as marked by the user, for example for editing.
    rule : "paper" for all measures exactly as in the paper; see `scanloom.stages.lod.measures`.
    """
    h = hierarchy
    middle, radius = h.spheres
    axis, angle = h.cones
    frustum = measures.frustum_share(view, middle, radius)
    silhouette = measures.silhouette_weight(view, middle, radius, axis, angle, rule=rule)
    error = view.pixels(h.shape_bound, middle, radius)
    marked = np.zeros(h.nodes)
    if region is not None:
        inside = region.holds(h.vertices)
        vertices = np.array([len(h.vertices_of(n)) for n in range(h.nodes)], np.float64)
        of_node = np.array([inside[h.vertices_of(n)].sum() for n in range(h.nodes)], np.float64)
        for node in range(h.nodes - 1, 0, -1):
            of_node[h.parent[node]] = max(of_node[h.parent[node]], of_node[node])
        marked = measures.marked_share(of_node, vertices, rule=rule)
    local = measures.local_measure(frustum, silhouette, error, marked, rule=rule)
    # Descendants can be refined only after their ancestors, so an ancestor inherits their priority.
    for node in range(h.nodes - 1, 0, -1):
        local[h.parent[node]] = max(local[h.parent[node]], local[node])
    return Weights(frustum, silhouette, error, marked, local)


def adjust(
    front: Front,
    weights: Weights,
    limit: float,
    *,
    split_above: float = measures.SPLIT_ABOVE,
    merge_below: float = 0.8 * measures.SPLIT_ABOVE,
) -> Front:
    """Adjust a front to the weights, with at most `limit` triangles (lambda_G).

    Nodes are refined if their local measure exceeds `split_above`. Refined nodes stay refined until it falls
    to `merge_below`; this hysteresis prevents oscillation. Nodes with the largest error come first. The node
    that exceeds the limit is refined partially.

    Parameters
    ----------
    front : changed in place.
    weights : from `evaluate`.
    limit : maximum number of triangles.
    split_above, merge_below : thresholds of the local measure.

    Returns
    -------
    The front itself.
    """
    h = front.hierarchy
    were_open = {int(p) for n in front.nodes for p in _above(h, n)}
    state = {0: 0}
    there = int(h.coarse[0])
    heap = [(-float(weights.error_px[0]), 0)]
    while heap:
        _, node = heapq.heappop(heap)
        if not weights.local[node] > (merge_below if node in were_open else split_above):
            continue
        more = int(h.full[node] - h.coarse[node])
        if there + more > limit:
            state[node] = h.splits_for(node, int(limit) - there)
            break
        there += more
        if not len(h.children[node]):
            state[node] = int(h.splits[node])
            continue
        del state[node]
        for child in h.children[node]:
            state[int(child)] = 0
            heapq.heappush(heap, (-float(weights.error_px[child]), int(child)))
    return front.restore(state)


def _above(hierarchy: Levels, node: int) -> list[int]:
    above = []
    while (node := int(hierarchy.parent[node])) >= 0:
        above.append(node)
    return above
