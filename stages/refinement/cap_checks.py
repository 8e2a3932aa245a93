"""Checks of hole caps: folds, and contacts with other surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.refinement.cap_shaping import Caps
from scanloom.stages.surface.cap_remeshing import Floats, compute_normals
from scanloom.stages.surface.edges import Edges, Ids, build_edges, is_known_key
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import is_degenerate

# Minimum cosine between the normals of adjacent triangles (150°), and maximum ratio of rim edges with a
# sharper fold, because noisy rims are folded as well.
_MIN_FOLD_COSINE, _MAX_FOLDED_RIM_RATIO = -0.866, 0.2
# Minimum distance from other surface in edge lengths. Surface within this number of rings around the rim is
# not tested.
_MIN_CLEARANCE_EDGES, _NEAR_RINGS = 0.7, 4


class CapSamples(NamedTuple):
    """Points on caps.

    Attributes
    ----------
    points, normals : (k, 3) positions in metres, and unit normals.
    holes : (k,) hole of each.
    """

    points: Floats
    normals: Floats
    holes: Ids


def sample_caps(caps: Caps) -> CapSamples:
    """Sample the caps at centroids and at midpoints of edges."""
    cap_mesh = caps.cap_mesh
    corners = cap_mesh.points[cap_mesh.triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    points = np.concatenate([corners.mean(axis=1), middles.reshape(-1, 3)])
    normals = _normalize(compute_normals(cap_mesh.points, cap_mesh.triangles))
    edges = build_edges(cap_mesh.triangles, len(cap_mesh.points))
    # Midpoints of rim edges are measured surface; midpoints of inner edges are sampled once.
    inner = edges.halfedges[edges.start[edges.triangle_count == 2]]
    chosen = np.concatenate([np.arange(len(corners)), len(corners) + inner])
    triangles = np.concatenate([np.arange(len(corners)), inner // 3])
    return CapSamples(points[chosen], normals[triangles], cap_mesh.holes[cap_mesh.patches][triangles])


def find_folded(caps: Caps) -> NDArray[np.bool_]:
    """Return a mask of the holes whose cap is folded, or has triangles without area."""
    cap_mesh, given = caps.cap_mesh, caps.around.triangles
    owners = cap_mesh.holes[cap_mesh.patches]
    is_folded = np.zeros(len(caps.around.loops), bool)
    is_folded[owners[is_degenerate(cap_mesh.points, cap_mesh.triangles)]] = True
    used = np.zeros(len(cap_mesh.points), bool)
    used[cap_mesh.triangles] = True
    around = given[np.count_nonzero(used[given], axis=1) >= 2]
    triangles = np.concatenate([cap_mesh.triangles, around])
    normals = _normalize(compute_normals(cap_mesh.points, triangles))
    edges = build_edges(triangles, len(cap_mesh.points))
    (paired,) = np.nonzero(edges.triangle_count == 2)
    first, second = (edges.halfedges[edges.start[paired] + k] // 3 for k in (0, 1))
    folds = (normals[first] * normals[second]).sum(axis=1) < _MIN_FOLD_COSINE
    # Triangles of caps come first.
    lower, upper = np.minimum(first, second)[folds], np.maximum(first, second)[folds]
    is_folded[owners[lower[upper < len(owners)]]] = True
    at_rim = (lower < len(owners)) & (upper >= len(owners))
    counts = np.bincount(owners[lower[at_rim]], minlength=len(is_folded))
    return is_folded | (counts > _MAX_FOLDED_RIM_RATIO * np.array([len(loop) for loop in caps.around.loops]))


def find_contacts(
    mesh: Mesh, edges: Edges, loops: Sequence[Ids], samples: CapSamples, mean_edge: float
) -> NDArray[np.bool_]:
    """Return a mask of the samples that touch surface other than around their rim, or another cap.

    Parameters
    ----------
    loops : rim vertices of each hole, numbered as in the mesh.
    """
    from scipy.spatial import cKDTree

    points, holes = samples.points, samples.holes
    reach = _MIN_CLEARANCE_EDGES * mean_edge
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    is_inside = [(x >= a) & (x <= b) for x, a, b in zip(mesh.vertices.T, low, high, strict=True)]
    candidates = np.flatnonzero(np.logical_and.reduce(is_inside))
    tree = cKDTree(points)
    contacts = tree.sparse_distance_matrix(
        cKDTree(mesh.vertices[candidates]), reach, output_type="coo_matrix"
    )
    touched, vertices = contacts.row, candidates[contacts.col]
    near = _find_near_vertices(edges, loops, len(mesh.vertices))
    is_other = ~is_known_key(holes[touched] * len(mesh.vertices) + vertices, near)
    found = np.zeros(len(points), bool)
    found[touched[is_other]] = True
    between = tree.query_pairs(reach, output_type="ndarray")
    found[between[holes[between[:, 0]] != holes[between[:, 1]]]] = True
    return found


def _find_near_vertices(edges: Edges, loops: Sequence[Ids], vertex_count: int) -> Ids:
    """Return the vertices within some rings of each rim, ascending, as hole · vertex_count + vertex."""
    first, second = edges.ends.T
    is_near = np.zeros(vertex_count, bool)
    is_near[np.concatenate(loops)] = True
    for _ in range(_NEAR_RINGS - 1):
        reached = is_near[first] != is_near[second]
        is_near[edges.ends[reached]] = True
    # Only these edges lead from one ring to the next.
    ends = edges.ends[is_near[first] | is_near[second]]
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    keys = np.sort(np.concatenate([hole * vertex_count + loop for hole, loop in enumerate(loops)]))
    newest = keys
    for _ in range(_NEAR_RINGS):
        holes, vertices = np.divmod(newest, vertex_count)
        starts, stops = (np.searchsorted(ends[:, 0], vertices, side) for side in ("left", "right"))
        counts = stops - starts
        offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        neighbours = ends[np.repeat(starts, counts) + offsets, 1]
        reached = np.sort(np.repeat(holes, counts) * vertex_count + neighbours)
        newest = reached[(np.diff(reached, prepend=-1) != 0) & ~is_known_key(reached, keys)]
        keys = np.sort(np.concatenate([keys, newest]))
    return keys


def _normalize(normals: Floats) -> Floats:
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(lengths, np.finfo(np.float64).tiny))
