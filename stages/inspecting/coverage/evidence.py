"""How well frames have measured a surface: how many, from how near and how straight.

Points of the surface are looked up in each depth map: where it agrees, the frame has measured the place. One
vertex stands for all of a small cube that face alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from stages.inspecting.coverage.views import Floats, Singles, View

# Points that are looked up in each frame, about.
_POINTS = 80_000
# Of its depth, and of the edges of the mesh: so far a surface may be off a depth map that measured it.
_SAME_DEPTH = np.float32(0.03)
_SAME_EDGES = 2.0
# Flatter than at this cosine a frame tells nothing of a place.
_LEAST_COSINE = np.float32(0.03)
# Triangles from what was measured that are as well seen.
_RIM = 2


@dataclass(frozen=True, eq=False)
class Probes:
    """Vertices that stand for those around them.

    Attributes
    ----------
    points, normals : (k, 3) float32, metres from the origin on.
    of_vertex : (n,) which of them stands for a vertex.
    tolerance : metres that depth may differ by, beside its share.
    """

    points: Singles
    normals: Singles
    of_vertex: NDArray[np.int64]
    tolerance: float


@dataclass(frozen=True, eq=False)
class Measured:
    """The probes that a frame measured, and how.

    Attributes
    ----------
    rows : (k,) their numbers.
    cosines : (k,) float32, of the angle between their normals and the line to the camera.
    depths : (k,) float32, metres.
    """

    rows: NDArray[np.intp]
    cosines: Singles
    depths: Singles


@dataclass(frozen=True, eq=False)
class Evidence:
    """What frames have measured of places.

    Attributes
    ----------
    frames : (n,) int32, how many measured it.
    cosine : (n,) float32, of the angle between its normal and the straightest look at it; 0 for none.
    distance : (n,) float32, metres, from which the nearest of them did; infinite for none.
    pixel : (n,) float32, metres, the width of a pixel there in the frame that shows it best; infinite for
        none.
    """

    frames: NDArray[np.int32]
    cosine: Singles
    distance: Singles
    pixel: Singles

    @classmethod
    def none(cls, count: int) -> Evidence:
        """Return that of places that no frame has measured yet."""
        return cls(
            np.zeros(count, np.int32),
            np.zeros(count, np.float32),
            np.full(count, np.inf, np.float32),
            np.full(count, np.inf, np.float32),
        )

    def add(self, found: Measured, focal: float) -> None:
        """Count what a frame measured; `focal` in pixels."""
        rows = found.rows
        self.frames[rows] += 1
        self.cosine[rows] = np.maximum(self.cosine[rows], found.cosines)
        self.distance[rows] = np.minimum(self.distance[rows], found.depths)
        self.pixel[rows] = np.minimum(self.pixel[rows], found.depths / np.float32(focal) / found.cosines)

    def at(self, rows: NDArray[np.int64]) -> Evidence:
        """Return that of some places."""
        return Evidence(self.frames[rows], self.cosine[rows], self.distance[rows], self.pixel[rows])


def probes_of(vertices: Floats, normals: Floats, edge: float, area: float) -> Probes:
    """Choose vertices that stand for those around them.

    Parameters
    ----------
    vertices, normals : (n, 3) metres, from the origin on.
    edge : metres, the median of the mesh.
    area : m², of all of it.
    """
    size = max(1.5 * edge, (area / _POINTS) ** 0.5)
    cells = np.floor((vertices - vertices.min(axis=0)) / size).astype(np.int64)
    # The two sides of a sheet are two places.
    facing = np.abs(normals).argmax(axis=1)
    is_back = np.take_along_axis(normals, facing[:, None], axis=1)[:, 0] < 0
    extent = cells.max(axis=0) + 1
    keys = ((cells[:, 0] * extent[1] + cells[:, 1]) * extent[2] + cells[:, 2]) * 6 + 2 * facing + is_back
    _, of_vertex = np.unique(keys, return_inverse=True)
    of_vertex = of_vertex.reshape(-1)
    # The one that is nearest to the middle of its fellows: at borders less than elsewhere is measured.
    counts = np.bincount(of_vertex)
    middles = np.stack([np.bincount(of_vertex, axis) / counts for axis in vertices.T], axis=1)
    away = ((vertices - middles[of_vertex]) ** 2).sum(axis=1)
    order = np.lexsort((away, of_vertex))
    chosen = order[np.concatenate([[0], np.cumsum(counts)[:-1]])]
    return Probes(
        vertices[chosen].astype(np.float32), normals[chosen].astype(np.float32), of_vertex, _SAME_EDGES * edge
    )


def measured_by(view: View, probes: Probes, origin: Floats) -> Measured:
    """Return which probes a frame has measured, and how."""
    columns, rows, z = view.in_camera(probes.points)
    inside, pixels = view.pixels(columns, rows, z)
    depth = view.depth.reshape(-1)[pixels]
    towards = (view.place - origin).astype(np.float32) - probes.points[inside]
    away = np.sqrt(np.einsum("kx,kx->k", towards, towards))
    cosines = np.einsum("kx,kx->k", towards, probes.normals[inside]) / np.maximum(away, np.float32(1e-9))
    z = z[inside]
    # Across a pixel a slope is that much deeper.
    slope = z / np.float32(view.camera.fx) / np.maximum(cosines, np.float32(0.2))
    reach = np.maximum(_SAME_DEPTH * z, np.float32(probes.tolerance)) + slope
    agrees = (depth > 0) & (cosines > _LEAST_COSINE) & (np.abs(depth - z) <= reach)
    return Measured(inside[agrees], cosines[agrees], z[agrees])


def with_rims(evidence: Evidence, triangles: NDArray[np.int32]) -> Evidence:
    """Return evidence of vertices (n,) that at rims is that of those beside them.

    Fusion goes on a voxel or two beyond what was measured; what no frame measured but what is beside it is no
    place of its own.
    """
    for _ in range(_RIM):
        corners = triangles.astype(np.int64)
        frames = evidence.frames[corners]
        best = np.take_along_axis(corners, frames.argmax(axis=1)[:, None], axis=1)
        is_bare = (frames == 0) & (frames.max(axis=1, keepdims=True) > 0)
        to, of = corners[is_bare], np.broadcast_to(best, corners.shape)[is_bare]
        # The last of those that write to one vertex stays: that of most frames.
        order = np.lexsort((of, evidence.frames[of]))
        source = np.arange(len(evidence.frames))
        source[to[order]] = of[order]
        evidence = evidence.at(source)
    return evidence
