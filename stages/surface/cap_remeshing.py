"""Remeshing of hole caps to the edge length of the surface around them.

The caps of all holes are processed together, as one list of triangles. Edges of the rim and between patches
stay. Source: Liepa, "Filling holes in meshes", 2003: alternating splits and Delaunay flips.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import (
    Edges,
    Ids,
    build_edges,
    is_known_key,
    make_edge_keys,
    step_to_next_corner,
)
from scanloom.stages.surface.mesh import Triangles

Floats = NDArray[np.float64]

# Edges longer than this multiple of the target length are split.
_MAX_EDGE_RATIO = 4 / 3
# Maximum number of passes. Each split pass halves the longest edges; each flip pass does the worst flips.
_MAX_SPLIT_PASSES, _MAX_FLIP_PASSES = 12, 30
# Minimum cotangent sum of the angles opposite an edge; Delaunay edges have at least 0.
_MIN_COTANGENT_SUM = -1e-6
# Minimum area of the triangles that a flip creates, as part of the area of both.
_MIN_FLIP_RATIO = 1e-5
# Part of the way to the mean of its neighbours that a vertex moves after each split pass.
_RELAXATION_STEP = 0.5


@dataclass(frozen=True, eq=False)
class CapMesh:
    """Caps of several holes.

    Attributes
    ----------
    points : (n, 3) vertices of the mesh, then vertices of the caps, metres.
    triangles : (m, 3) triangles of the caps.
    patches : (m,) patch of each triangle. Patches meet at rims and creases.
    holes : (p,) hole of each patch. Caps of different holes have no common vertex.
    fixed_count : number of leading vertices that stay: vertices of the mesh, and of creases.
    """

    points: Floats
    triangles: Triangles
    patches: Ids
    holes: Ids
    fixed_count: int


def remesh_caps(caps: CapMesh, target_lengths: Floats, taken_edges: Ids) -> CapMesh:
    """Split long edges of caps, and make the edges Delaunay.

    Parameters
    ----------
    target_lengths : (k,) edge length of each patch, metres.
    taken_edges : (e, 2) edges of the mesh between rim vertices, which no flip may create again.
    """
    caps = _flip_edges(caps, taken_edges)
    for _ in range(_MAX_SPLIT_PASSES):
        split = _split_edges(caps, target_lengths)
        if split is None:
            break
        caps = _flip_edges(_relax(split), taken_edges)
    return caps


def find_inner_edges(edges: Edges, patches: Ids) -> tuple[Ids, Ids, Ids]:
    """Return the edges inside of patches, with both halfedges of each."""
    (paired,) = np.nonzero(edges.triangle_count == 2)
    first, second = edges.halfedges[edges.start[paired]], edges.halfedges[edges.start[paired] + 1]
    inside = patches[first // 3] == patches[second // 3]
    return paired[inside], first[inside], second[inside]


def compute_cotangents(points: Floats, triangles: Ids) -> Floats:
    """Compute the cotangent (3 m,) of the angle opposite each halfedge."""
    corners = triangles.reshape(-1)
    after = step_to_next_corner(np.arange(len(corners)))
    apex = corners[step_to_next_corner(after)]
    # One coordinate at a time is faster than rows of three.
    u, v = ([x[ends] - x[apex] for x in points.T] for ends in (corners, corners[after]))
    x, y, z = (u[i] * v[j] - u[j] * v[i] for i, j in ((1, 2), (2, 0), (0, 1)))
    doubled = np.sqrt(x * x + y * y + z * z)
    product = u[0] * v[0] + u[1] * v[1] + u[2] * v[2]
    return np.asarray(product / np.maximum(doubled, np.finfo(np.float64).tiny))


def compute_normals(points: Floats, triangles: Ids) -> Floats:
    """Compute the normals (m, 3) of triangles; their length is twice the area."""
    a, b, c = triangles.T
    u, v = ([x[corner] - x[a] for x in points.T] for corner in (b, c))
    return np.stack([u[i] * v[j] - u[j] * v[i] for i, j in ((1, 2), (2, 0), (0, 1))], axis=1)


def _split_edges(caps: CapMesh, target_lengths: Floats) -> CapMesh | None:
    """Split edges that are too long, the longest first; None without such edges."""
    edges = build_edges(caps.triangles, len(caps.points))
    inner, first, second = find_inner_edges(edges, caps.patches)
    ends = edges.ends[inner]
    lengths = np.linalg.norm(caps.points[ends[:, 0]] - caps.points[ends[:, 1]], axis=1)
    ratios = lengths / target_lengths[caps.patches[first // 3]]
    (long,) = np.nonzero(ratios > _MAX_EDGE_RATIO)
    chosen = long[_select_independent(-ratios[long], first[long] // 3, second[long] // 3)]
    if not len(chosen):
        return None
    middles = len(caps.points) + np.arange(len(chosen), dtype=np.int32)
    triangles = caps.triangles.copy()
    added = []
    for halfedges in (first[chosen], second[chosen]):
        rows, tail = np.divmod(halfedges, 3)
        head, apex = (tail + 1) % 3, (tail + 2) % 3
        added.append(np.stack([middles, triangles[rows, head], triangles[rows, apex]], axis=1))
        triangles[rows, head] = middles
    rows = np.concatenate([first[chosen], second[chosen]]) // 3
    return replace(
        caps,
        points=np.concatenate([caps.points, caps.points[ends[chosen]].mean(axis=1)]),
        triangles=np.concatenate([triangles, *added]),
        patches=np.concatenate([caps.patches, caps.patches[rows]]),
    )


def _flip_edges(caps: CapMesh, taken_edges: Ids) -> CapMesh:
    """Flip edges until all edges inside of patches are Delaunay."""
    count = len(caps.points)
    taken = np.sort(make_edge_keys(*taken_edges.T))
    points, triangles = caps.points, caps.triangles.copy()
    active = np.arange(len(triangles))
    for _ in range(_MAX_FLIP_PASSES):
        own, patches = triangles[active], caps.patches[active]
        edges = build_edges(own, count)
        _, first, second = find_inner_edges(edges, patches)
        cotangents = compute_cotangents(points, own)
        sums = cotangents[first] + cotangents[second]
        (bad,) = np.nonzero(sums < _MIN_COTANGENT_SUM)
        (t, i), (s, j) = np.divmod(first[bad], 3), np.divmod(second[bad], 3)
        a, b, c = (own[t, (i + k) % 3] for k in range(3))
        d = own[s, (j + 2) % 3]
        keys = make_edge_keys(c, d)
        is_new = ~(is_known_key(keys, taken) | is_known_key(keys, make_edge_keys(*edges.ends.T)))
        turned = [np.stack(one, axis=1) for one in ((a, d, c), (d, b, c))]
        is_valid = is_new & _is_flip_valid(points, own[t], own[s], turned)
        (valid,) = np.nonzero(is_valid)
        # Two flips may create the same edge.
        _, once = np.unique(keys[valid], return_index=True)
        valid = valid[np.sort(once)]
        chosen = valid[_select_independent(sums[bad[valid]], t[valid], s[valid])]
        if not len(chosen):
            break
        triangles[active[t[chosen]]], triangles[active[s[chosen]]] = (one[chosen] for one in turned)
        # Caps without a flip are done.
        is_changed = np.zeros(len(caps.holes), bool)
        is_changed[caps.holes[patches[t[chosen]]]] = True
        active = active[is_changed[caps.holes[patches]]]
    return replace(caps, triangles=triangles)


def _is_flip_valid(points: Floats, first: Ids, second: Ids, turned: list[Ids]) -> NDArray[np.bool_]:
    """Return a mask of the flips that neither fold the surface nor create a triangle without area."""
    before = compute_normals(points, first) + compute_normals(points, second)
    total = np.linalg.norm(before, axis=1)
    first_area, second_area = ((compute_normals(points, one) * before).sum(axis=1) for one in turned)
    smallest = np.minimum(first_area, second_area)
    return np.asarray(smallest > _MIN_FLIP_RATIO * total**2)


def _relax(caps: CapMesh) -> CapMesh:
    """Move free vertices towards the mean of their neighbours, where no triangle turns over."""
    points, triangles = caps.points, caps.triangles
    edges = build_edges(triangles, len(points))
    a, b = edges.ends.T
    degrees = np.bincount(edges.ends.reshape(-1), minlength=len(points))
    sums = np.stack(
        [
            np.bincount(a, x[b], minlength=len(points)) + np.bincount(b, x[a], minlength=len(points))
            for x in points.T
        ],
        axis=1,
    )
    (free,) = np.nonzero((degrees > 0) & (np.arange(len(points)) >= caps.fixed_count))
    moved = points.copy()
    moved[free] += _RELAXATION_STEP * (sums[free] / degrees[free, None] - points[free])
    before = compute_normals(points, triangles)
    for _ in range(_MAX_FLIP_PASSES):
        after = compute_normals(moved, triangles)
        # Half the squared area: triangles neither turn over nor shrink much.
        turned = (before * after).sum(axis=1) < 0.25 * (before * before).sum(axis=1)
        vertices = np.unique(triangles[turned])
        vertices = vertices[(moved[vertices] != points[vertices]).any(axis=1)]
        if not len(vertices):
            break
        moved[vertices] = points[vertices]
    return replace(caps, points=moved)


def _select_independent(costs: Floats, first: Ids, second: Ids) -> Ids:
    """Select edges without common triangle, the best ones first.

    Parameters
    ----------
    costs : (k,) lower is better.
    first, second : (k,) triangles of each edge.
    """
    left = np.argsort(costs, kind="stable")
    is_used = np.zeros(max(first.max(initial=-1), second.max(initial=-1)) + 1, bool)
    best = np.empty(len(is_used), np.int64)
    chosen = []
    while len(left):
        ranks = np.arange(len(left))
        best[:] = len(left)
        np.minimum.at(best, first[left], ranks)
        np.minimum.at(best, second[left], ranks)
        taken = left[(best[first[left]] == ranks) & (best[second[left]] == ranks)]
        chosen.append(taken)
        is_used[first[taken]] = is_used[second[taken]] = True
        left = left[~(is_used[first[left]] | is_used[second[left]])]
    return np.concatenate([np.empty(0, np.int64), *chosen])
