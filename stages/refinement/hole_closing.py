"""Closing of holes by continuing the surface, where no frame has seen free space.

1. Triangulate each border loop up to a given length, and remesh the caps to the edge length of the mesh.
2. Continue planes: a cap between vertices of one plane is on that plane; between two or three planes, it has
   straight creases where the planes meet. Other caps continue the surface smoothly.
3. Reject caps through which a frame has measured a surface behind, and caps that touch other surface or fold.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.refinement.cap_checks import find_contacts, find_folded, sample_caps
from scanloom.stages.refinement.cap_planes import fit_planes
from scanloom.stages.refinement.cap_shaping import Caps, select_surroundings, shape_caps
from scanloom.stages.refinement.free_space import FreeSpaceTest
from scanloom.stages.surface.cap_remeshing import Floats
from scanloom.stages.surface.edges import build_edges
from scanloom.stages.surface.hole_filling import find_caps
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas

# Default limit of the border length, in mean edge lengths.
_DEFAULT_LENGTH_EDGES = 20.0
# A measurement at least this number of edge lengths behind a cap proves free space.
_FREE_SPACE_EDGES = 2.0
# Deviation of the vertices of a cap relative to the median: as for vertices that no frame measured.
_FILLED_DEVIATION_RATIO = 3.0


@dataclass(frozen=True)
class Filling:
    """Filling of a hole.

    Attributes
    ----------
    area : area, m².
    border_length : length of the border, metres.
    center : centre of gravity, metres.
    """

    area: float
    border_length: float
    center: tuple[float, float, float]

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-ready dictionary, with units in the keys."""
        return {"area_m2": self.area, "border_m": self.border_length, "point_m": list(self.center)}


@dataclass(frozen=True, eq=False)
class ClosedHoles:
    """Mesh with closed holes.

    Attributes
    ----------
    mesh : vertices and triangles of the caps are appended to the input. New vertices are black; see
        `color_fillings`.
    is_filled : (n,) True for the vertices of caps.
    deviations, plane_ids : (n,) as in `RefinementResult`.
    fillings : fillings of the closed holes, the largest first.
    """

    mesh: Mesh
    is_filled: NDArray[np.bool_]
    deviations: Floats
    plane_ids: NDArray[np.int32]
    fillings: tuple[Filling, ...] = ()

    @property
    def area(self) -> float:
        """Total area of the fillings, m²."""
        return sum(filling.area for filling in self.fillings)


def close_holes(
    mesh: Mesh,
    plane_ids: NDArray[np.int32],
    deviations: Floats,
    noise: DepthNoise,
    show_frames: Callable[[FreeSpaceTest], object],
    max_length: float | None = None,
) -> ClosedHoles:
    """Close the holes of a refined mesh where no frame has seen free space.

    Parameters
    ----------
    mesh : oriented manifold.
    plane_ids, deviations : (n,) as in `RefinementResult`.
    show_frames : calls `observe` of the given test with all depth maps; not called if there is no hole.
    max_length : maximum length of the border of a hole, metres; None for 20 mean edge lengths.
    """
    edges = build_edges(mesh.triangles, len(mesh.vertices))
    unchanged = ClosedHoles(mesh, np.zeros(len(mesh.vertices), bool), deviations, plane_ids)
    if not len(edges.ends):
        return unchanged
    x, y, z = (axis[edges.ends[:, 1]] - axis[edges.ends[:, 0]] for axis in mesh.vertices.T)
    mean_edge = float(np.sqrt(x * x + y * y + z * z).mean())
    limit = _DEFAULT_LENGTH_EDGES * mean_edge if max_length is None else max_length
    found = find_caps(mesh, edges, limit) if limit > 0 else []
    if not found:
        return unchanged
    loops = [cap.loop for cap in found]
    around = select_surroundings(mesh, loops)
    planes = fit_planes(mesh.vertices, plane_ids, int(plane_ids.max(initial=-1)) + 1)
    caps = shape_caps(
        around, found, planes, plane_ids[around.vertices], deviations[around.vertices], mean_edge
    )
    is_kept = ~find_folded(caps)
    samples = sample_caps(caps)
    is_kept[samples.holes[find_contacts(mesh, edges, loops, samples, mean_edge)]] = False
    tested = is_kept[samples.holes]
    test = FreeSpaceTest(
        samples.points[tested], samples.normals[tested], noise, _FREE_SPACE_EDGES * mean_edge
    )
    if tested.any():
        show_frames(test)
    is_kept[samples.holes[tested][test.is_free]] = False
    return _append_caps(unchanged, caps, is_kept) if is_kept.any() else unchanged


def _append_caps(given: ClosedHoles, caps: Caps, is_kept: NDArray[np.bool_]) -> ClosedHoles:
    """Append the kept caps to the mesh."""
    cap_mesh, mesh = caps.cap_mesh, given.mesh
    own = cap_mesh.triangles[is_kept[cap_mesh.holes[cap_mesh.patches]]]
    used = np.zeros(len(cap_mesh.points), bool)
    used[own] = True
    count = len(caps.around.points)
    new = count + np.flatnonzero(used[count:])
    number = np.empty(len(cap_mesh.points), np.int32)
    number[:count] = caps.around.vertices
    number[new] = len(mesh.vertices) + np.arange(len(new))
    colors = mesh.colors
    if colors is not None:
        colors = np.concatenate([colors, np.zeros((len(new), 3), np.uint8)])
    filled = np.full(len(new), _FILLED_DEVIATION_RATIO * float(np.median(given.deviations)))
    return ClosedHoles(
        mesh=Mesh(
            np.concatenate([mesh.vertices, cap_mesh.points[new]]),
            np.concatenate([mesh.triangles, number[own]]),
            colors,
            up=mesh.up,
        ),
        is_filled=np.concatenate([given.is_filled, np.ones(len(new), bool)]),
        deviations=np.concatenate([given.deviations, filled]),
        plane_ids=np.concatenate([given.plane_ids, caps.label_planes()[new].astype(np.int32)]),
        fillings=_list_fillings(caps, is_kept),
    )


def _list_fillings(caps: Caps, is_kept: NDArray[np.bool_]) -> tuple[Filling, ...]:
    """List the kept caps, the largest first."""
    cap_mesh, count = caps.cap_mesh, len(is_kept)
    holes = cap_mesh.holes[cap_mesh.patches]
    areas = compute_areas(cap_mesh.points, cap_mesh.triangles)
    centers = cap_mesh.points[cap_mesh.triangles].mean(axis=1)
    totals = np.bincount(holes, areas, count)
    moments = np.stack([np.bincount(holes, areas * axis, count) for axis in centers.T], axis=1)
    fillings = []
    for hole in np.flatnonzero(is_kept)[np.argsort(-totals[is_kept], kind="stable")].tolist():
        rim = caps.around.points[caps.around.loops[hole]]
        length = float(np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).sum())
        x, y, z = (moments[hole] / totals[hole]).tolist()
        fillings.append(Filling(float(totals[hole]), length, (x, y, z)))
    return tuple(fillings)
