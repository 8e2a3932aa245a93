"""Cut of triangles along a plane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Triangles, Vertices

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PlaneCut:
    """Triangles that were cut along a plane.

    Attributes
    ----------
    vertices : (n, 3) given vertices, followed by new ones on the plane.
    triangles : (m, 3) int32.
    parents : (m,) given triangle that contains each triangle.
    heights : (n,) signed distance of the vertices from the plane; exactly 0 for new vertices.
    """

    vertices: Vertices
    triangles: Triangles
    parents: Ids
    heights: Floats


def cut_along_plane(
    vertices: Vertices, triangles: Triangles, heights: Floats, chosen: NDArray[np.bool_]
) -> PlaneCut:
    """Cut triangles with corners on both sides of a plane.

    Neighbours share the new vertices, if all triangles at an edge that crosses the plane are chosen.

    Parameters
    ----------
    heights : (n,) signed distance of the vertices from the plane.
    chosen : (m,) triangles that may be cut.
    """
    signs = np.sign(heights).astype(np.int64)[triangles]
    is_cut = chosen & (signs.min(axis=1) < 0) & (signs.max(axis=1) > 0)
    signs = signs[is_cut]
    touches = (signs == 0).any(axis=1)
    # The first corner is on the plane, or alone on its side.
    is_first = np.where(touches[:, None], signs == 0, signs == -signs.sum(axis=1, keepdims=True))
    order = (is_first.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(triangles[is_cut].astype(np.int64), order, axis=1).T
    alone = ~touches
    tails = np.concatenate([a[alone], a[alone], b[touches]])
    heads = np.concatenate([b[alone], c[alone], c[touches]])
    # The smaller index comes first, so that both triangles at an edge compute the same position.
    edges = np.sort(np.stack([tails, heads], axis=1), axis=1)
    edges, index = np.unique(edges, axis=0, return_inverse=True)
    low, high = edges.T
    ratio = (heights[low] / (heights[low] - heights[high]))[:, None]
    points = vertices[low] * (1 - ratio) + vertices[high] * ratio
    count = int(np.count_nonzero(alone))
    ab, ac, bc = np.split(len(vertices) + index.reshape(-1), [count, 2 * count])
    a0, b0, c0 = a[alone], b[alone], c[alone]
    rows = [
        *((a0, ab, ac), (ab, b0, c0), (ab, c0, ac)),
        *((a[touches], b[touches], bc), (a[touches], bc, c[touches])),
    ]
    (cut,) = np.nonzero(is_cut)
    return PlaneCut(
        np.concatenate([vertices, points]),
        np.concatenate([triangles[~is_cut], *(np.stack(one, axis=1) for one in rows)]).astype(np.int32),
        np.concatenate([np.flatnonzero(~is_cut), *[cut[alone]] * 3, *[cut[touches]] * 2]),
        np.concatenate([heights, np.zeros(len(points))]),
    )
