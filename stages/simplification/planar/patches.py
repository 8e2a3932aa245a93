"""Near-planar patches of a mesh, and visualisation of patches by colour."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.mesh import Colors, Mesh

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]

# Largest patches listed individually in the statistics.
_LISTED_PATCHES = 10

# Golden-ratio step on the hue circle: hues of consecutive patches are far apart.
_GOLDEN_RATIO_STEP = 0.618034


@dataclass(frozen=True, eq=False)
class Patches:
    """Near-planar patches of a mesh, sorted by decreasing area.

    Attributes
    ----------
    triangle_patch : (m,) int32, patch of each triangle; -1 for triangles that use a vertex twice.
    normals : (k, 3) float64, mean normal of each patch; 0 without area.
    origins : (k, 3) float64, metres, a point on each patch's plane.
    areas : (k,) float64, m².
    triangles : (k,) int32, triangle count of each patch.
    thickness : (k,) float64, metres, distance of two parallel planes that enclose the patch.
    neighbour_test_count : number of neighbour tests during growth; run time is proportional to it.
    """

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    triangle_patch: Ids
    normals: Floats
    origins: Floats
    areas: Floats
    triangles: Ids
    thickness: Floats
    neighbour_test_count: int

    @property
    def count(self) -> int:
        """Number of patches."""
        return len(self.areas)

    def to_dict(self) -> dict[str, Any]:
        """Return statistics: number of patches, total area, and the largest patches."""
        area = float(self.areas.sum())
        rows = zip(self.areas, self.triangles, self.thickness, self.normals, strict=True)
        largest = [
            {
                "area_m2": float(own),
                "triangles": int(triangles),
                "thickness_m": float(thickness),
                "normal": normal.tolist(),
            }
            for own, triangles, thickness, normal in (row for row, _ in zip(rows, range(_LISTED_PATCHES)))  # noqa: B905
        ]
        # Patches are sorted by area, so the first ones cover half of it.
        half_area_count = int(np.searchsorted(np.cumsum(self.areas), 0.5 * area)) + 1 if self.count else 0
        return {
            "patches": self.count,
            "area_m2": area,
            "patches_of_half_the_area": half_area_count,
            "largest_patches": largest,
        }


def generate_patch_colors(count: int) -> Colors:
    """Generate distinct colours (count, 3) for consecutive patches."""
    turns = np.arange(count) * _GOLDEN_RATIO_STEP % 1
    levels = [
        colorsys.hsv_to_rgb(hue, (0.55, 0.8)[i % 2], (0.95, 0.75, 0.85)[i % 3]) for i, hue in enumerate(turns)
    ]
    colors: Colors = np.rint(np.array(levels).reshape(-1, 3) * 255).astype(np.uint8)
    return colors


def color_by_patch(mesh: Mesh, triangle_patch: Ids) -> Mesh:
    """Colour each patch of a mesh differently.

    Vertices on patch borders are duplicated so that colours do not blend. Triangles without a patch are
    removed.

    Parameters
    ----------
    mesh : Mesh
    triangle_patch : (m,) int32, patch of each triangle; -1 for none.
    """
    kept = triangle_patch >= 0
    corners, patch = mesh.triangles[kept].ravel(), np.repeat(triangle_patch[kept], 3)
    keys = patch.astype(np.int64) * max(len(mesh.vertices), 1) + corners
    distinct, first, number = np.unique(keys, return_index=True, return_inverse=True)
    colors = (
        generate_patch_colors(int(patch.max(initial=-1)) + 1)[patch[first]]
        if len(distinct)
        else np.zeros((0, 3), np.uint8)
    )
    triangles = number.reshape(-1, 3).astype(np.int32)
    return Mesh(mesh.vertices[corners[first]], triangles, colors=colors, up=mesh.up)
