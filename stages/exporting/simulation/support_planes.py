"""Level planes of a scan on which objects can stand: floors, table tops and shelves."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.simplification.planar.run import planar_patches
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# Minimum cosine between the normal of a level patch and up (10°). The up direction of a scan is accurate to
# about one degree.
_MIN_LEVEL_COSINE = 0.985
# Minimum cosine between coplanar patches (5°).
_MIN_COPLANAR_COSINE = 0.996
# Minimum reach above a plane, as a ratio of the bounding-box diagonal. Patches without noise have no
# thickness.
_MIN_REACH_RATIO = 0.002
# A plane is a lid of an object if it has less area than both limits: a ratio of the largest plane, and m².
_MIN_AREA_RATIO, _MIN_AREA_M2 = 0.15, 0.25


@dataclass(frozen=True, eq=False)
class LevelPlane:
    """Level plane of a scan.

    Attributes
    ----------
    normal : (3,) unit normal, pointing up.
    offset_m : dot product of the normal and the points of the plane.
    reach_m : thickness of the largest patch, with a minimum. Surface higher than this above the plane is not
        part of it.
    triangles : (m,) mask of the triangles of the patches.
    area_m2 : area of the patches.
    """

    normal: Floats
    offset_m: float
    reach_m: float
    triangles: NDArray[np.bool_]
    area_m2: float

    def measure_heights(self, points: Floats) -> Floats:
        """Return the signed distance (n,) of points from the plane; positive above."""
        return np.asarray(points @ self.normal - self.offset_m)

    def is_same(self, other: LevelPlane) -> bool:
        """Return True if both planes have about the same height."""
        return abs(self.offset_m - other.offset_m) <= max(self.reach_m, other.reach_m)


def find_support_planes(mesh: Mesh) -> list[LevelPlane]:
    """Find the large level planes of a z-up mesh, the largest first.

    Coplanar patches, such as a table top on both sides of an object, are one plane.
    """
    patches = planar_patches(Mesh(mesh.vertices, mesh.triangles))
    pending = np.flatnonzero(patches.normals[:, 2] >= _MIN_LEVEL_COSINE).tolist()
    planes: list[LevelPlane] = []
    min_reach = _MIN_REACH_RATIO * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    while pending:
        first = pending[0]
        normal, reach = patches.normals[first], max(float(patches.thickness[first]), min_reach)
        heights = (patches.origins[pending] - patches.origins[first]) @ normal
        alike = (np.abs(heights) <= reach) & (patches.normals[pending] @ normal >= _MIN_COPLANAR_COSINE)
        own = np.array(pending)[alike]
        pending = np.array(pending)[~alike].tolist()
        area = float(patches.areas[own].sum())
        mean = patches.areas[own] @ patches.normals[own]
        mean = mean / np.linalg.norm(mean)
        offset = float(patches.areas[own] @ (patches.origins[own] @ mean) / area)
        planes.append(LevelPlane(mean, offset, reach, np.isin(patches.triangle_patch, own), area))
    limit = min(_MIN_AREA_RATIO * max((one.area_m2 for one in planes), default=0.0), _MIN_AREA_M2)
    return sorted((one for one in planes if one.area_m2 >= limit), key=lambda one: -one.area_m2)
