"""View-dependent evaluation of a hierarchy, and adjustment of its front."""

from __future__ import annotations

import heapq

import numpy as np

from scanloom.stages.lod import refinement_measures
from scanloom.stages.lod.front import Front, Region
from scanloom.stages.lod.levels import Levels
from scanloom.stages.lod.refinement_measures import RefinementWeights, Rule
from scanloom.stages.lod.view import View


def evaluate(
    hierarchy: Levels, view: View, region: Region | None = None, *, rule: Rule = "corrected"
) -> RefinementWeights:
    """Compute the refinement priority of each node (Wang, Lu and Pan 2012, section 2.2).

    The error is the proven error of the node's coarse mesh, in pixels of the view.

    Parameters
    ----------
    hierarchy : levels to evaluate.
    view : view that determines visibility and pixel size.
    region : vertices inside count as marked by the user, for example for editing.
    rule : "paper" for all measures exactly as in the paper; see `scanloom.stages.lod.refinement_measures`.
    """
    h = hierarchy
    middle, radius = h.spheres
    axis, angle = h.cones
    frustum = refinement_measures.compute_frustum_ratio(view, middle, radius)
    silhouette = refinement_measures.compute_silhouette_weight(view, middle, radius, axis, angle, rule=rule)
    error = view.project_lengths(h.shape_bound, middle, radius)
    marked = np.zeros(h.nodes)
    if region is not None:
        inside = region.contains(h.vertices)
        vertices = np.array([len(h.list_vertices(n)) for n in range(h.nodes)], np.float64)
        marked_by_node = np.array([inside[h.list_vertices(n)].sum() for n in range(h.nodes)], np.float64)
        for node in range(h.nodes - 1, 0, -1):
            marked_by_node[h.parent[node]] = max(marked_by_node[h.parent[node]], marked_by_node[node])
        marked = refinement_measures.compute_marked_ratio(marked_by_node, vertices, rule=rule)
    local = refinement_measures.compute_local_measure(frustum, silhouette, error, marked, rule=rule)
    # Descendants can be refined only after their ancestors, so an ancestor inherits their priority.
    for node in range(h.nodes - 1, 0, -1):
        local[h.parent[node]] = max(local[h.parent[node]], local[node])
    return RefinementWeights(frustum, silhouette, error, marked, local)


def adjust(
    front: Front,
    weights: RefinementWeights,
    limit: float,
    *,
    split_above: float = refinement_measures.SPLIT_THRESHOLD,
    merge_below: float = 0.8 * refinement_measures.SPLIT_THRESHOLD,
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
    refined_before = {int(p) for n in front.nodes for p in _list_ancestors(h, n)}
    state = {0: 0}
    triangle_count = int(h.coarse[0])
    heap = [(-float(weights.error_px[0]), 0)]
    while heap:
        _, node = heapq.heappop(heap)
        if not weights.local[node] > (merge_below if node in refined_before else split_above):
            continue
        added_triangles = int(h.full[node] - h.coarse[node])
        if triangle_count + added_triangles > limit:
            state[node] = h.count_affordable_splits(node, int(limit) - triangle_count)
            break
        triangle_count += added_triangles
        if not len(h.children[node]):
            state[node] = int(h.splits[node])
            continue
        del state[node]
        for child in h.children[node]:
            state[int(child)] = 0
            heapq.heappush(heap, (-float(weights.error_px[child]), int(child)))
    return front.restore(state)


def _list_ancestors(hierarchy: Levels, node: int) -> list[int]:
    ancestors = []
    while (node := int(hierarchy.parent[node])) >= 0:
        ancestors.append(node)
    return ancestors
