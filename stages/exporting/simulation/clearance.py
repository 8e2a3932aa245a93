"""Cuts that keep the convex parts of a body clear of the parts of other bodies."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.exporting.simulation.convex_part import (
    ConvexPart,
    PartSet,
    compute_separation,
    cut_points,
    find_separating_plane,
    is_apart,
    try_build_part,
)
from scanloom.stages.exporting.simulation.decomposition import limit_corners
from scanloom.stages.surface.mesh import Mesh

Floats = NDArray[np.float64]

# A part that needs more cuts is dropped.
_MAX_CUTS = 100
# Distance between parts after a cut, as a ratio of the size of the surface. Simulators use single precision.
_CLEARANCE_RATIO = 1e-6


def clear_obstacles(
    parts: Iterable[ConvexPart], obstacles: PartSet, surface: Mesh, overlap_m: float
) -> list[ConvexPart]:
    """Cut parts until they overlap no obstacle.

    A cut keeps all of the surface in its part if a plane separates this surface from the obstacle. Otherwise
    it is along the face that cuts off least, and some of the surface is outside of the result.

    Parameters
    ----------
    parts : parts that contain `surface`.
    obstacles : parts of other bodies.
    overlap_m : overlap of the halves of a part that gets too many corners.
    """
    corners = surface.vertices[surface.triangles]
    clearance = _CLEARANCE_RATIO * float(np.ptp(surface.vertices, axis=0).max())
    return [
        half
        for part in parts
        for one in _clear_part(part, obstacles, corners, clearance)
        for half in limit_corners(one, overlap_m)
    ]


def _clear_part(
    part: ConvexPart, obstacles: PartSet, corners: Floats, clearance_m: float
) -> Iterator[ConvexPart]:
    """Yield the part after all cuts; nothing if too little of it is left."""
    for _ in range(_MAX_CUTS):
        touching = [one for one in obstacles.list_touching(part) if not is_apart(one, part)]
        if not touching:
            yield part
            return
        deepest = min(touching, key=lambda one: compute_separation(one, part)[0])
        cut = try_build_part(cut_points(part, _measure_cut(part, deepest, corners, clearance_m)))
        if cut is None:
            return
        part = cut


def _measure_cut(part: ConvexPart, obstacle: ConvexPart, corners: Floats, clearance_m: float) -> Floats:
    """Return the heights (k,) of the corners of a part above the plane of a cut."""
    own = _collect_inner_points(part, corners)
    plane = find_separating_plane(own, obstacle.vertices) if len(own) else None
    if plane is not None:
        return np.asarray(part.vertices @ plane[:3] + plane[3])
    _, face, is_own = compute_separation(part, obstacle)
    if is_own:
        # A face of the part moves inwards until it is next to the obstacle.
        depth = -float((obstacle.vertices @ face[:3] + face[3]).min())
        return np.asarray(part.vertices @ face[:3] + face[3] + depth + clearance_m)
    return np.asarray(clearance_m - (part.vertices @ face[:3] + face[3]))


def _collect_inner_points(part: ConvexPart, corners: Floats) -> Floats:
    """Return points (k, 3) whose hull contains the surface of triangles (n, 3, 3) inside of a part."""
    low, high = part.vertices.min(axis=0), part.vertices.max(axis=0)
    corners = corners[((corners.min(axis=1) <= high) & (corners.max(axis=1) >= low)).all(axis=1)]
    heights = corners @ part.planes[:, :3].T + part.planes[:, 3]
    corners = corners[(heights.min(axis=1) <= 0).all(axis=1)]
    is_inside = part.contains(corners.reshape(-1, 3)).reshape(-1, 3).all(axis=1)
    polygons = [_clip_polygon(one, part.planes) for one in corners[~is_inside]]
    return np.unique(np.concatenate([corners[is_inside].reshape(-1, 3), *polygons]), axis=0)


def _clip_polygon(polygon: Floats, planes: Floats) -> Floats:
    """Return the corners of the portion of a convex polygon below all planes."""
    for plane in planes:
        heights = polygon @ plane[:3] + plane[3]
        if not len(polygon) or heights.max() <= 0:
            continue
        following, next_heights = np.roll(polygon, -1, axis=0), np.roll(heights, -1)
        crossing = heights * next_heights < 0
        ratio = (heights[crossing] / (heights[crossing] - next_heights[crossing]))[:, None]
        on_plane = polygon[crossing] * (1 - ratio) + following[crossing] * ratio
        order = np.concatenate((np.flatnonzero(heights <= 0), np.flatnonzero(crossing) + 0.5))
        polygon = np.concatenate((polygon[heights <= 0], on_plane))[np.argsort(order)]
    return polygon
