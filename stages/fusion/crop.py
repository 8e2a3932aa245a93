"""What of a scan's world is fused, in a box, in a ball, above a plane: of depth maps, and of the mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.params import Corners, Point
from scanloom.stages.fusion.scene import in_words
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Crop:
    """Places that are in all of these; what is None says nothing.

    Attributes
    ----------
    box : lowest and highest corner, metres.
    center, radius : of a ball, metres.
    normal, height : a place p is above the plane where normal · p > height, metres; normal has length 1.
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
            parts.append(f"the box {in_words(self.box[:3])} to {in_words(self.box[3:])} m")
        if self.center is not None and self.radius is not None:
            parts.append(f"{self.radius:.4g} m around {in_words(self.center)}")
        if self.normal is not None:
            parts.append(f"what is above the plane {in_words(self.normal)} · p = {self.height:.4g} m")
        return " and ".join(parts) or "everything"

    def outside(self, points: Floats) -> Floats:
        """Return how far outside points (n, 3) are, metres: (n,), 0 or less inside.

        It is the distance to the nearest place inside, or less beside edges and corners.
        """
        far = np.full(len(points), -np.inf)
        if self.box is not None:
            low, high = np.array(self.box[:3]), np.array(self.box[3:])
            far = np.maximum(far, np.maximum(low - points, points - high).max(axis=1))
        if self.center is not None and self.radius is not None:
            far = np.maximum(far, np.linalg.norm(points - np.array(self.center), axis=1) - self.radius)
        if self.normal is not None:
            far = np.maximum(far, self.height - points @ np.array(self.normal))
        return far


def shown(view: PosedDepth, crop: Crop, by: float = 0.0) -> Mask:
    """Return which pixels (h, w) show what is inside of a crop, or no more than `by` metres outside."""
    seen = np.asarray(view.surface.depth > 0)
    if crop:
        seen[seen] = crop.outside(view.points(1)) <= by
    return seen


def cropped(view: PosedDepth, crop: Crop) -> PosedDepth:
    """Return a view without the depth of what is outside of a crop."""
    depth = np.where(shown(view, crop), view.surface.depth, np.float32(0))
    return replace(view, surface=replace(view.surface, depth=depth))


def cut(mesh: Mesh, crop: Crop) -> Mesh:
    """Return the triangles of a mesh with vertex colours that have all corners inside, in the same order."""
    return part_of(mesh, within(mesh, crop)) if crop else mesh


def within(mesh: Mesh, crop: Crop) -> Mask:
    """Return which triangles (m,) of a mesh have all corners inside of a crop."""
    return np.asarray((crop.outside(mesh.vertices) <= 0)[mesh.triangles].all(axis=1))


def part_of(mesh: Mesh, kept: Mask) -> Mesh:
    """Return the triangles of a mesh with vertex colours that are kept (m,), in the same order."""
    triangles, used = mesh.triangles[kept], corners_of(mesh, kept)
    rank = np.cumsum(used, dtype=np.int32) - 1
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], rank[triangles].astype(np.int32), colors)


def corners_of(mesh: Mesh, kept: Mask) -> Mask:
    """Return which vertices (n,) are corners of the triangles that are kept (m,)."""
    used = np.zeros(len(mesh.vertices), np.bool_)
    used[mesh.triangles[kept]] = True
    return used
