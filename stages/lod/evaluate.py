"""View-dependent evaluation of a hierarchy, and adjustment of its front."""

from __future__ import annotations

import heapq

import numpy as np

from scanloom.stages.lod import refinement_measures
from scanloom.stages.lod.front import Front, Region
from scanloom.stages.lod.levels import Levels
from scanloom.stages.lod.refinement_measures import Floats, RefinementWeights, Rule
from scanloom.stages.lod.view import View


def evaluate(
    hierarchy: Levels,
    view: View,
    region: Region | None = None,
    *,
    constraints: Region | None = None,
    silhouette: bool = True,
    rule: Rule = "corrected",
) -> RefinementWeights:
    """Compute the refinement priority of each node (Wang, Lu and Pan 2012, section 2.2).

    Nodes with a vertex in `region` get the weight 1, so that `adjust` refines the region to the finest level,
    in or out of view. Other nodes are weighted by their proven error in pixels, by the ratio of their
    vertices in `constraints`, and by the silhouette. An ancestor inherits the maximum weight of its
    descendants, because descendants can be refined only after their ancestors.

    With rule="paper", gamma_v is the ratio of a node's vertices in the frustum, and gamma_s, lambda_d and
    lambda_L follow equations (3) to (5), without inheritance. The handle is `region`, and the constrained
    vertices are `constraints`, or `region` without constraints. The rule deviates from the paper in these
    points:

    - A node is a cluster, not a vertex. Its bounding sphere is centred on its bounding box, its influence
      area are the vertices of the finest level, and it belongs to the handle if one of these vertices does.
    - gamma_g is the proven two-sided distance of the node's coarse mesh from its part of the input, projected
      to pixels. The paper takes the Hausdorff distance of one-ring neighbourhoods.
    - The view cone (beta) encloses the node's sphere, and gamma_s is 1 if the eye is in the sphere. The paper
      defines neither beta for an extended area nor this case.
    - A node of weight 0 is drawn at its coarsest by `adjust`. The paper removes it.

    Parameters
    ----------
    hierarchy : levels to evaluate.
    view : view that determines visibility and pixel size.
    region : handle of a deformation, or another region that needs the finest level.
    constraints : region of constrained vertices of a deformation. By the corrected rule, nodes with more than
        half of their vertices inside are refined.
    silhouette : False to leave out the silhouette measure (gamma_s = 0).
    rule : "corrected", or "paper" for the paper's formulas.
    """
    h = hierarchy
    middle, radius = h.spheres
    axis, angle = h.cones
    of = h.node_vertices
    frustum = _compute_frustum_ratio(h, view, rule)
    outline = np.zeros(h.nodes)
    if silhouette:
        outline = refinement_measures.compute_silhouette_weight(view, middle, radius, axis, angle, rule=rule)
    error = view.project_lengths(h.shape_bound, middle, radius)
    marked = np.zeros(h.nodes)
    if region is not None or constraints is not None:
        is_inside = np.zeros(len(h.vertices), bool) if region is None else region.contains(h.vertices)
        is_constrained = None if constraints is None else constraints.contains(h.vertices)
        if rule == "paper":
            is_handle = of.count_finest(is_inside) > 0
            constrained = of.count_finest(is_inside if is_constrained is None else is_constrained)
        else:
            is_handle = of.contains_any(is_inside)
            constrained = np.zeros(h.nodes) if is_constrained is None else of.count_finest(is_constrained)
        marked = refinement_measures.compute_marked_weight(
            is_handle, constrained, of.finest_counts, rule=rule
        )
    local = refinement_measures.compute_local_measure(frustum, outline, error, marked, rule=rule)
    return RefinementWeights(
        frustum, outline, error, marked, local if rule == "paper" else of.propagate_max(local)
    )


def _compute_frustum_ratio(hierarchy: Levels, view: View, rule: Rule) -> Floats:
    middle, radius = hierarchy.spheres
    if rule == "corrected":
        return refinement_measures.compute_frustum_ratio(view, middle, radius)
    normals, offsets = view.compute_planes()
    of = hierarchy.node_vertices
    inside = of.count_finest((hierarchy.vertices @ normals.T <= offsets).all(axis=1))
    return refinement_measures.compute_frustum_ratio(view, middle, radius, inside, of.finest_counts)


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
    to `merge_below`; this hysteresis prevents oscillation. Marked nodes come first, then nodes with the
    largest error. The node that exceeds the limit is refined partially.

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
    is_marked = weights.marked > refinement_measures.MAX_MARKED_RATIO
    heap = [(not is_marked[0], -float(weights.error_px[0]), 0)]
    while heap:
        *_, node = heapq.heappop(heap)
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
            heapq.heappush(heap, (not is_marked[child], -float(weights.error_px[child]), int(child)))
    return front.restore(state)


def _list_ancestors(hierarchy: Levels, node: int) -> list[int]:
    ancestors = []
    while (node := int(hierarchy.parent[node])) >= 0:
        ancestors.append(node)
    return ancestors
