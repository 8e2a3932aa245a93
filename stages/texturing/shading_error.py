"""Angle between the shading normals of a simplified mesh and those of its original."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.comparing.surface_sampling import sample_stratified
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_triangle_normals
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.color_lookup import DISTANCE_PROBES
from scanloom.stages.texturing.shading_normals import NormalMaps, ShadingNormals, has_normal_map
from scanloom.stages.texturing.tangent_frames import get_corner_normals, interpolate_corners

_SAMPLES = 50_000


@dataclass(frozen=True)
class ShadingError:
    """Angle between shading normals over the surface of the simplified mesh.

    Attributes
    ----------
    median_deg, p90_deg, mean_deg : median, 90th percentile and mean, degrees.
    """

    median_deg: float
    p90_deg: float
    mean_deg: float

    @classmethod
    def from_normals(cls, normals: NDArray[np.floating], expected: NDArray[np.floating]) -> ShadingError:
        """Compare normals (k, 3) of any length with unit normals (k, 3)."""
        unit = normals / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)[:, None]
        # The chord is precise for small angles, unlike the cosine.
        chord = np.linalg.norm(unit - expected, axis=1)
        angles = np.degrees(2 * np.arcsin((chord / 2).clip(0, 1)))
        return cls(float(np.median(angles)), float(np.percentile(angles, 90)), float(angles.mean()))

    def to_dict(self) -> dict[str, float]:
        """Return the metrics for JSON."""
        return {"median_deg": self.median_deg, "p90_deg": self.p90_deg, "mean_deg": self.mean_deg}


class ShadingComparison:
    """Samples of a simplified mesh, with the shading normals of its original.

    A sample is compared with the nearest point of the original that faces the same way.
    """

    def __init__(self, simplified: Mesh, original: Mesh, original_normals: ShadingNormals) -> None:
        areas = compute_areas(simplified.vertices, simplified.triangles)
        points = sample_stratified(np.cumsum(areas), slice(0, _SAMPLES), _SAMPLES, np.random.default_rng(0))
        self._triangles, self._weights = points.triangles, points.weights
        flat = compute_triangle_normals(simplified)
        surface = _kernels.NearestSurface(original.vertices, original.triangles, wanted_threads=0)
        corners = simplified.vertices[simplified.triangles]
        probes = corners[:: math.ceil(len(corners) / DISTANCE_PROBES)].mean(axis=1)
        _, _, distances = surface.find_nearest(probes, wanted_threads=0)
        triangles, weights, _ = surface.find_nearest_facing(
            np.einsum("kc,kcx->kx", self._weights, corners[self._triangles]),
            flat[self._triangles],
            reach=2 * float(distances.max()),
            wanted_threads=0,
        )
        self._expected = original_normals(triangles, weights)

    def measure(self, mesh: Mesh) -> ShadingError:
        """Measure the error of a mesh with the geometry of the simplified mesh, as viewers shade it.

        Its normals count, else the normals of its triangles. Normal maps are applied.
        """
        normals = interpolate_corners(
            get_corner_normals(mesh).astype(np.float32), self._triangles, self._weights.astype(np.float32)
        )
        if has_normal_map(mesh):
            NormalMaps(mesh).apply(normals, self._triangles, self._weights)
        return ShadingError.from_normals(normals, self._expected)
