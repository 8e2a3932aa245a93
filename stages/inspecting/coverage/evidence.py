"""How well frames have measured a surface: how many, from how near, how straight, and how much they agree.

Points of the surface are looked up in each depth map: where it agrees, the frame has measured the place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.probes import Ids, Probes
from scanloom.stages.inspecting.coverage.views import Floats, Singles, View

# Of its depth, and of the edges of the mesh: so far a surface may be off a depth map that measured it.
_SAME_DEPTH = np.float32(0.03)
_SAME_EDGES = 2.0
# Flatter than at this cosine a frame tells nothing of a place.
_LEAST_COSINE = np.float32(0.03)


@dataclass(frozen=True, eq=False)
class Measured:
    """The probes that a frame measured, and how.

    Attributes
    ----------
    rows : (k,) their numbers.
    cosines : (k,) float32, of the angle between their normals and the line to the camera.
    depths : (k,) float32, metres.
    heights : (k,) float32, metres, of what was measured above the surface, along its normal.
    """

    rows: NDArray[np.intp]
    cosines: Singles
    depths: Singles
    heights: Singles


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
    cosines : (n,) float32, sum over all frames that measured it.
    squares : (n,) float32, m², sum of how far off it they did, along its normal.
    """

    frames: NDArray[np.int32]
    cosine: Singles
    distance: Singles
    pixel: Singles
    cosines: Singles
    squares: Singles

    @classmethod
    def none(cls, count: int) -> Evidence:
        """Return that of places that no frame has measured yet."""
        zero, infinite = np.zeros(count, np.float32), np.full(count, np.inf, np.float32)
        return cls(np.zeros(count, np.int32), zero, infinite, infinite.copy(), zero.copy(), zero.copy())

    @property
    def mean_cosine(self) -> Singles:
        """Return the mean over the frames that measured it (n,); 0 for none."""
        return np.asarray(self.cosines / np.maximum(self.frames, 1), np.float32)

    @property
    def spread(self) -> Singles:
        """Return how far off it, RMS, frames have measured it (n,), along its normal, metres; 0 for none."""
        return np.asarray(np.sqrt(self.squares / np.maximum(self.frames, 1)), np.float32)

    def add(self, found: Measured, focal: float) -> None:
        """Count what a frame measured; `focal` in pixels."""
        rows = found.rows
        self.frames[rows] += 1
        self.cosine[rows] = np.maximum(self.cosine[rows], found.cosines)
        self.distance[rows] = np.minimum(self.distance[rows], found.depths)
        self.pixel[rows] = np.minimum(self.pixel[rows], found.depths / np.float32(focal) / found.cosines)
        self.cosines[rows] += found.cosines
        self.squares[rows] += found.heights**2

    def at(self, rows: Ids) -> Evidence:
        """Return that of some places."""
        return Evidence(
            self.frames[rows],
            self.cosine[rows],
            self.distance[rows],
            self.pixel[rows],
            self.cosines[rows],
            self.squares[rows],
        )


def measured_by(view: View, probes: Probes, origin: Floats, edge: float) -> Measured:
    """Return which probes a frame has measured, and how; `edge` is the median of the mesh, metres."""
    columns, rows, z = view.in_camera(probes.points)
    inside, pixels = view.pixels(columns, rows, z)
    depth = view.depth.reshape(-1)[pixels]
    towards = (view.place - origin).astype(np.float32) - probes.points[inside]
    away = np.sqrt(np.einsum("kx,kx->k", towards, towards))
    cosines = np.einsum("kx,kx->k", towards, probes.normals[inside]) / np.maximum(away, np.float32(1e-9))
    z = z[inside]
    # Across a pixel a slope is that much deeper.
    slope = z / np.float32(view.camera.fx) / np.maximum(cosines, np.float32(0.2))
    reach = np.maximum(_SAME_DEPTH * z, np.float32(_SAME_EDGES * edge)) + slope
    agrees = (depth > 0) & (cosines > _LEAST_COSINE) & (np.abs(depth - z) <= reach)
    chosen = inside[agrees]
    heights = _heights(view, probes, chosen, pixels[agrees])
    return Measured(chosen, cosines[agrees], z[agrees], heights)


def _heights(view: View, probes: Probes, chosen: NDArray[np.intp], pixels: Ids) -> Singles:
    """Return how high above the surface what was measured lies, along the normals of probes (k,), metres."""
    # In the middle of a pixel: beside it a slope has another depth.
    rows, columns = np.divmod(pixels, view.camera.width)
    above = view.point_at(columns, rows) - view.turn @ probes.points[chosen].T - view.shift[:, None]
    return np.asarray(np.einsum("xk,xk->k", view.turn @ probes.normals[chosen].T, above), np.float32)
