"""Evidence for a surface: number, distance, angle and consistency of its measurements.

Surface points are projected into each depth map. A frame whose depth agrees has measured the point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.depth_view import DepthView, Floats, Singles
from scanloom.stages.inspecting.coverage.probes import Ids, Probes

# Tolerance between surface and depth map: the larger of a ratio of the depth and a number of mesh edges.
_DEPTH_TOLERANCE_RATIO = np.float32(0.03)
_TOLERANCE_EDGES = 2.0
# Minimum cosine to the normal; at more grazing angles, a frame provides no evidence.
_MIN_COSINE = np.float32(0.03)


@dataclass(frozen=True, eq=False)
class ProbeMeasurements:
    """Probes that a frame measured.

    Attributes
    ----------
    probe_indices : (k,) indices of the probes.
    cosines : (k,) float32, cosine of the angle between normal and line of sight.
    depths : (k,) float32, metres.
    heights : (k,) float32, height of the measured point above the surface along its normal, metres.
    """

    probe_indices: NDArray[np.intp]
    cosines: Singles
    depths: Singles
    heights: Singles


@dataclass(frozen=True, eq=False)
class Evidence:
    """Accumulated evidence from all frames per probe or vertex.

    Attributes
    ----------
    frame_counts : (n,) int32, number of frames that measured the point.
    max_cosine : (n,) float32, largest cosine between normal and line of sight; 0 without measurement.
    min_distance : (n,) float32, smallest measured depth in metres; infinite without measurement.
    min_pixel_size : (n,) float32, smallest pixel footprint on the surface in metres; infinite without
        measurement.
    cosine_sum : (n,) float32, sum of the cosines over all measuring frames.
    squared_height_sum : (n,) float32, sum of the squared heights above the surface, m².
    """

    frame_counts: NDArray[np.int32]
    max_cosine: Singles
    min_distance: Singles
    min_pixel_size: Singles
    cosine_sum: Singles
    squared_height_sum: Singles

    @classmethod
    def make_empty(cls, count: int) -> Evidence:
        """Return empty evidence for `count` points."""
        zero, infinite = np.zeros(count, np.float32), np.full(count, np.inf, np.float32)
        return cls(np.zeros(count, np.int32), zero, infinite, infinite.copy(), zero.copy(), zero.copy())

    @property
    def mean_cosine(self) -> Singles:
        """Mean cosine (n,) over the measuring frames; 0 without measurement."""
        return np.asarray(self.cosine_sum / np.maximum(self.frame_counts, 1), np.float32)

    @property
    def rms_height(self) -> Singles:
        """RMS distance (n,) of measurements from the surface, metres.

        Points without measurement have 0.
        """
        return np.asarray(np.sqrt(self.squared_height_sum / np.maximum(self.frame_counts, 1)), np.float32)

    def add(self, measured: ProbeMeasurements, focal_px: float) -> None:
        """Accumulate the measurements of a frame; `focal_px` is in pixels."""
        rows = measured.probe_indices
        self.frame_counts[rows] += 1
        self.max_cosine[rows] = np.maximum(self.max_cosine[rows], measured.cosines)
        self.min_distance[rows] = np.minimum(self.min_distance[rows], measured.depths)
        self.min_pixel_size[rows] = np.minimum(
            self.min_pixel_size[rows], measured.depths / np.float32(focal_px) / measured.cosines
        )
        self.cosine_sum[rows] += measured.cosines
        self.squared_height_sum[rows] += measured.heights**2

    def select(self, rows: Ids) -> Evidence:
        """Return the evidence of selected points."""
        return Evidence(
            self.frame_counts[rows],
            self.max_cosine[rows],
            self.min_distance[rows],
            self.min_pixel_size[rows],
            self.cosine_sum[rows],
            self.squared_height_sum[rows],
        )


def measure_probes(view: DepthView, probes: Probes, origin: Floats, median_edge: float) -> ProbeMeasurements:
    """Find the probes that a frame measured.

    Parameters
    ----------
    view : depth map and pose of the frame.
    probes : surface points.
    origin : (3,) origin of the probe coordinates, metres.
    median_edge : median edge length of the mesh, metres.
    """
    columns, rows, z = view.project_points(probes.points)
    inside, pixels = view.find_pixels(columns, rows, z)
    depth = view.depth.reshape(-1)[pixels]
    towards = (view.position - origin).astype(np.float32) - probes.points[inside]
    away = np.sqrt(np.einsum("kx,kx->k", towards, towards))
    cosines = np.einsum("kx,kx->k", towards, probes.normals[inside]) / np.maximum(away, np.float32(1e-9))
    z = z[inside]
    # Depth varies by this much across a pixel on an oblique surface.
    slope = z / np.float32(view.camera.fx) / np.maximum(cosines, np.float32(0.2))
    reach = np.maximum(_DEPTH_TOLERANCE_RATIO * z, np.float32(_TOLERANCE_EDGES * median_edge)) + slope
    agrees = (depth > 0) & (cosines > _MIN_COSINE) & (np.abs(depth - z) <= reach)
    chosen = inside[agrees]
    heights = _compute_heights(view, probes, chosen, pixels[agrees])
    return ProbeMeasurements(chosen, cosines[agrees], z[agrees], heights)


def _compute_heights(
    view: DepthView, probes: Probes, probe_indices: NDArray[np.intp], pixels: Ids
) -> Singles:
    """Compute heights (k,) of measured points along the probe normals, metres."""
    # Unproject at the pixel centre: on an oblique surface, depth is valid only there.
    rows, columns = np.divmod(pixels, view.camera.width)
    above = (
        view.unproject_pixels(columns, rows)
        - view.rotation @ probes.points[probe_indices].T
        - view.translation[:, None]
    )
    return np.asarray(
        np.einsum("xk,xk->k", view.rotation @ probes.normals[probe_indices].T, above), np.float32
    )
