"""Evidence for a surface: number, distance, angle and consistency of its measurements.

Surface points are projected into each depth map. A frame whose depth agrees has measured the point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.probes import Ids, Probes
from scanloom.stages.inspecting.coverage.views import Floats, Singles, View

# Tolerance between surface and depth map: the larger of a ratio of the depth and a number of mesh edges.
_SAME_DEPTH = np.float32(0.03)
_SAME_EDGES = 2.0
# Minimum cosine to the normal; at more grazing angles, a frame provides no evidence.
_LEAST_COSINE = np.float32(0.03)


@dataclass(frozen=True, eq=False)
class Measured:
    """Probes that a frame measured.

    Attributes
    ----------
    rows : (k,) indices of the probes.
    cosines : (k,) float32, cosine of the angle between normal and line of sight.
    depths : (k,) float32, metres.
    heights : (k,) float32, height of the measured point above the surface along its normal, metres.
    """

    rows: NDArray[np.intp]
    cosines: Singles
    depths: Singles
    heights: Singles


@dataclass(frozen=True, eq=False)
class Evidence:
    """Accumulated evidence from all frames per probe or vertex.

    Attributes
    ----------
    frames : (n,) int32, number of frames that measured the point.
    cosine : (n,) float32, largest cosine between normal and line of sight; 0 without measurement.
    distance : (n,) float32, smallest measured depth in metres; infinite without measurement.
    pixel : (n,) float32, smallest pixel footprint on the surface in metres; infinite without measurement.
    cosines : (n,) float32, sum of the cosines over all measuring frames.
    squares : (n,) float32, sum of the squared heights above the surface, m².
    """

    frames: NDArray[np.int32]
    cosine: Singles
    distance: Singles
    pixel: Singles
    cosines: Singles
    squares: Singles

    @classmethod
    def none(cls, count: int) -> Evidence:
        """Return empty evidence for `count` points."""
        zero, infinite = np.zeros(count, np.float32), np.full(count, np.inf, np.float32)
        return cls(np.zeros(count, np.int32), zero, infinite, infinite.copy(), zero.copy(), zero.copy())

    @property
    def mean_cosine(self) -> Singles:
        """Mean cosine (n,) over the measuring frames; 0 without measurement."""
        return np.asarray(self.cosines / np.maximum(self.frames, 1), np.float32)

    @property
    def spread(self) -> Singles:
        """RMS distance (n,) of measurements from the surface, metres.

        Points without measurement have 0.
        """
        return np.asarray(np.sqrt(self.squares / np.maximum(self.frames, 1)), np.float32)

    def add(self, found: Measured, focal: float) -> None:
        """Accumulate the measurements of a frame; `focal` is in pixels."""
        rows = found.rows
        self.frames[rows] += 1
        self.cosine[rows] = np.maximum(self.cosine[rows], found.cosines)
        self.distance[rows] = np.minimum(self.distance[rows], found.depths)
        self.pixel[rows] = np.minimum(self.pixel[rows], found.depths / np.float32(focal) / found.cosines)
        self.cosines[rows] += found.cosines
        self.squares[rows] += found.heights**2

    def at(self, rows: Ids) -> Evidence:
        """Return the evidence of selected points."""
        return Evidence(
            self.frames[rows],
            self.cosine[rows],
            self.distance[rows],
            self.pixel[rows],
            self.cosines[rows],
            self.squares[rows],
        )


def measured_by(view: View, probes: Probes, origin: Floats, edge: float) -> Measured:
    """Find the probes that a frame measured.

    Parameters
    ----------
    view : depth map and pose of the frame.
    probes : surface points.
    origin : (3,) origin of the probe coordinates, metres.
    edge : median edge length of the mesh, metres.
    """
    columns, rows, z = view.in_camera(probes.points)
    inside, pixels = view.pixels(columns, rows, z)
    depth = view.depth.reshape(-1)[pixels]
    towards = (view.place - origin).astype(np.float32) - probes.points[inside]
    away = np.sqrt(np.einsum("kx,kx->k", towards, towards))
    cosines = np.einsum("kx,kx->k", towards, probes.normals[inside]) / np.maximum(away, np.float32(1e-9))
    z = z[inside]
    # Depth varies by this much across a pixel on an oblique surface.
    slope = z / np.float32(view.camera.fx) / np.maximum(cosines, np.float32(0.2))
    reach = np.maximum(_SAME_DEPTH * z, np.float32(_SAME_EDGES * edge)) + slope
    agrees = (depth > 0) & (cosines > _LEAST_COSINE) & (np.abs(depth - z) <= reach)
    chosen = inside[agrees]
    heights = _heights(view, probes, chosen, pixels[agrees])
    return Measured(chosen, cosines[agrees], z[agrees], heights)


def _heights(view: View, probes: Probes, chosen: NDArray[np.intp], pixels: Ids) -> Singles:
    """Compute heights (k,) of measured points along the probe normals, metres."""
    # Unproject at the pixel centre: on an oblique surface, depth is valid only there.
    rows, columns = np.divmod(pixels, view.camera.width)
    above = view.point_at(columns, rows) - view.turn @ probes.points[chosen].T - view.shift[:, None]
    return np.asarray(np.einsum("xk,xk->k", view.turn @ probes.normals[chosen].T, above), np.float32)
