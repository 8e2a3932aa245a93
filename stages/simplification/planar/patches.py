"""Near-planar patches of a mesh: what they are, and a mesh coloured by them."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.printing import by_figures, table
from scanloom.stages.surface.mesh import Colors, Mesh

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]

# How many patches the figures list one by one.
_LISTED = 10

# Hues that follow each other by this part of the circle never come near each other soon.
_GOLDEN = 0.618034


@dataclass(frozen=True, eq=False)
class Patches:
    """The near-planar patches of a mesh, numbered by area, largest first.

    Attributes
    ----------
    triangle_patch : (m,) int32, the patch of each triangle; -1 for one that names a vertex twice.
    normals : (k, 3) float64, the mean normal of each patch; 0 for one without area.
    origins : (k, 3) float64, metres, a point of its plane.
    areas : (k,) float64, m², of its triangles.
    triangles : (k,) int32, how many these are.
    thickness : (k,) float64, metres, the distance of the two planes that hold all its vertices between them.
    looks : how often a triangle's neighbour was looked at, which is what the time follows.
    """

    __repr__ = by_figures
    _repr_html_ = table

    triangle_patch: Ids
    normals: Floats
    origins: Floats
    areas: Floats
    triangles: Ids
    thickness: Floats
    looks: int

    @property
    def count(self) -> int:
        """Return how many patches there are."""
        return len(self.areas)

    def figures(self) -> dict[str, Any]:
        """Return the number of patches and the area, and the largest ones by themselves."""
        area = float(self.areas.sum())
        rows = zip(self.areas, self.triangles, self.thickness, self.normals, strict=True)
        largest = [
            {
                "area_m2": float(own),
                "triangles": int(triangles),
                "thickness_m": float(thickness),
                "normal": normal.tolist(),
            }
            for own, triangles, thickness, normal in (row for row, _ in zip(rows, range(_LISTED)))  # noqa: B905
        ]
        # Patches are sorted by area: so many of them make up half of it.
        half = int(np.searchsorted(np.cumsum(self.areas), 0.5 * area)) + 1 if self.count else 0
        return {
            "patches": self.count,
            "area_m2": area,
            "patches_of_half_the_area": half,
            "largest_patches": largest,
        }


def patch_colors(count: int) -> Colors:
    """Return a colour for each of so many patches, (count, 3), far from those of the numbers before."""
    turns = np.arange(count) * _GOLDEN % 1
    levels = [
        colorsys.hsv_to_rgb(hue, (0.55, 0.8)[i % 2], (0.95, 0.75, 0.85)[i % 3]) for i, hue in enumerate(turns)
    ]
    colors: Colors = np.rint(np.array(levels).reshape(-1, 3) * 255).astype(np.uint8)
    return colors


def colored_by_patch(mesh: Mesh, triangle_patch: Ids) -> Mesh:
    """Return the mesh with each patch in a colour of its own.

    A vertex on the border of patches is there once for each of them, so that no colours mix. Triangles that
    belong to no patch are left out.
    """
    kept = triangle_patch >= 0
    corners, patch = mesh.triangles[kept].ravel(), np.repeat(triangle_patch[kept], 3)
    keys = patch.astype(np.int64) * max(len(mesh.vertices), 1) + corners
    distinct, first, number = np.unique(keys, return_index=True, return_inverse=True)
    colors = (
        patch_colors(int(patch.max(initial=-1)) + 1)[patch[first]]
        if len(distinct)
        else np.zeros((0, 3), np.uint8)
    )
    triangles = number.reshape(-1, 3).astype(np.int32)
    return Mesh(mesh.vertices[corners[first]], triangles, colors=colors, up=mesh.up)
