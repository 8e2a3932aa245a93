"""Crop region of a fusion, applied to depth maps and meshes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.params import Corners, Point
from scanloom.stages.fusion.scene_extent import format_point
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Crop:
    """Intersection of a box, a ball and a half-space.

    Attributes
    ----------
    box : lowest and highest corner, metres, world; None for no box.
    center, radius : ball, metres; None for no ball.
    normal, height : half-space of the points p with normal · p > height (metres); normal has length 1. None
        for no half-space.
    """

    box: Corners | None = None
    center: Point | None = None
    radius: float | None = None
    normal: Point | None = None
    height: float = 0.0

    def __bool__(self) -> bool:
        return self != Crop()

    def __str__(self) -> str:
        parts = []
        if self.box is not None:
            parts.append(f"the box {format_point(self.box[:3])} to {format_point(self.box[3:])} m")
        if self.center is not None and self.radius is not None:
            parts.append(f"{self.radius:.4g} m around {format_point(self.center)}")
        if self.normal is not None:
            parts.append(
                f"the half-space above the plane {format_point(self.normal)} · p = {self.height:.4g} m"
            )
        return " and ".join(parts) or "everything"

    def compute_distance(self, points: Floats) -> Floats:
        """Return the distance of points (n, 3) to the crop region.

        Returns
        -------
        (n,) metres; 0 or less inside. Near edges and corners the value is a lower bound of the Euclidean
        distance.
        """
        distance = np.full(len(points), -np.inf)
        if self.box is not None:
            low, high = np.array(self.box[:3]), np.array(self.box[3:])
            distance = np.maximum(distance, np.maximum(low - points, points - high).max(axis=1))
        if self.center is not None and self.radius is not None:
            distance = np.maximum(
                distance, np.linalg.norm(points - np.array(self.center), axis=1) - self.radius
            )
        if self.normal is not None:
            distance = np.maximum(distance, self.height - points @ np.array(self.normal))
        return distance


def mask_pixels_inside(view: PosedDepth, crop: Crop, tolerance: float = 0.0) -> Mask:
    """Return a mask (h, w) of the pixels inside the crop.

    Parameters
    ----------
    tolerance : points at most this far outside count as inside, metres.
    """
    inside = np.asarray(view.surface.depth > 0)
    if crop:
        inside[inside] = crop.compute_distance(view.unproject_grid(1)) <= tolerance
    return inside


def crop_depth(view: PosedDepth, crop: Crop) -> PosedDepth:
    """Remove the depth of a view outside of the crop."""
    depth = np.where(mask_pixels_inside(view, crop), view.surface.depth, np.float32(0))
    return replace(view, surface=replace(view.surface, depth=depth))


def crop_mesh(mesh: Mesh, crop: Crop) -> Mesh:
    """Crop a mesh to the triangles whose three corners are inside.

    The order is preserved.
    """
    return select_triangles(mesh, mask_triangles_inside(mesh, crop)) if crop else mesh


def mask_triangles_inside(mesh: Mesh, crop: Crop) -> Mask:
    """Return a mask (m,) of the triangles inside the crop.

    A triangle is inside if its three corners are.
    """
    return np.asarray((crop.compute_distance(mesh.vertices) <= 0)[mesh.triangles].all(axis=1))


def select_triangles(mesh: Mesh, kept: Mask) -> Mesh:
    """Return a mesh with the triangles selected by the mask `kept` (m,), in unchanged order."""
    triangles, used = mesh.triangles[kept], mask_used_vertices(mesh, kept)
    rank = np.cumsum(used, dtype=np.int32) - 1
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], rank[triangles].astype(np.int32), colors)


def mask_used_vertices(mesh: Mesh, kept: Mask) -> Mask:
    """Return a mask (n,) of the vertices of the triangles in `kept` (m,)."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.triangles[kept]] = True
    return used
