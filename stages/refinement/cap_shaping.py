"""Shapes of hole caps: triangulated, remeshed, and placed on planes or on smooth continuations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from scanloom.stages.refinement.cap_planes import DividedCap, Planes, divide_cap, keep_whole
from scanloom.stages.surface.cap_fairing import fair
from scanloom.stages.surface.cap_remeshing import CapMesh, Floats, remesh_caps
from scanloom.stages.surface.edges import Ids, build_edges, is_known_key, make_edge_keys
from scanloom.stages.surface.hole_filling import LoopCap
from scanloom.stages.surface.loop_triangulation import triangulate_loops
from scanloom.stages.surface.mesh import Mesh, Triangles

# Rim vertices up to this many standard deviations or edge lengths from a plane are on the plane.
_PLANE_DEVIATIONS, _PLANE_EDGES = 3.0, 0.25
# Iterations of remeshing and smooth continuation: each one starts from a better shape.
_FAIRING_ITERATIONS = 2


@dataclass(frozen=True, eq=False)
class Surroundings:
    """Triangles of a mesh that touch the rims of holes.

    Attributes
    ----------
    vertices : (n,) their vertices, numbered as in the mesh, ascending.
    points : (n, 3) positions of the vertices, metres.
    triangles : (m, 3) as rows of `vertices`, in the order of the mesh.
    loops : rim vertices of each hole, as rows of `vertices`.
    """

    vertices: Ids
    points: Floats
    triangles: Triangles
    loops: Sequence[Ids]


@dataclass(frozen=True, eq=False)
class Caps:
    """Caps of all holes of a mesh, with their planes.

    Attributes
    ----------
    around : the mesh around the holes. Its vertices are the first ones of `cap_mesh`.
    cap_mesh : triangles of all caps.
    planes : (p,) plane of each patch, −1 for none.
    crease_planes : (c,) plane of each vertex on a crease.
    """

    around: Surroundings
    cap_mesh: CapMesh
    planes: Ids
    crease_planes: Ids

    def label_planes(self) -> Ids:
        """Return the plane of each vertex of a cap; −1 for none, and for vertices of the mesh."""
        planes = _find_planes(self.cap_mesh, self.planes)
        planes[len(self.around.points) : self.cap_mesh.fixed_count] = self.crease_planes
        return planes


def select_surroundings(mesh: Mesh, loops: Sequence[Ids]) -> Surroundings:
    """Select the triangles around holes.

    Parameters
    ----------
    loops : rim vertices of each hole.
    """
    is_rim = np.zeros(len(mesh.vertices), bool)
    is_rim[np.concatenate(loops)] = True
    triangles = mesh.triangles[is_rim[mesh.triangles].any(axis=1)]
    vertices = np.unique(triangles)
    rows = np.empty(len(mesh.vertices), np.int32)
    rows[vertices] = np.arange(len(vertices))
    return Surroundings(vertices, mesh.vertices[vertices], rows[triangles], [rows[loop] for loop in loops])


def shape_caps(
    around: Surroundings,
    found: Sequence[LoopCap],
    planes: Planes,
    plane_ids: Ids,
    deviations: Floats,
    mean_edge: float,
) -> Caps:
    """Triangulate, remesh and place the caps of all holes.

    Parameters
    ----------
    found : cap of each loop, of minimum area.
    planes : planes of the mesh.
    plane_ids, deviations : (n,) plane and standard deviation of each vertex in `around`; −1 for no plane.
    mean_edge : mean edge length of the mesh, metres.
    """
    tolerances = np.maximum(_PLANE_DEVIATIONS * deviations, _PLANE_EDGES * mean_edge)
    rims = [around.points[loop] for loop in around.loops]
    edge_lengths = [
        max(mean_edge, float(np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).mean())) for rim in rims
    ]
    divided = [
        divide_cap(rim, plane_ids[loop], tolerances[loop], planes, length)
        for rim, loop, length in zip(rims, around.loops, edge_lengths, strict=True)
    ]
    rim_edges = _find_rim_edges(around)
    parts = _triangulate_sections(around, divided, make_edge_keys(*rim_edges.T))
    points, triangles, patches = [around.points], [], []
    holes: list[int] = []
    patch_planes, lengths, crease_planes = [], [], []
    count = len(around.points)
    for hole, (loop, cap, division) in enumerate(zip(around.loops, found, divided, strict=True)):
        if division is None or (len(division.sections) > 1 and hole not in parts):
            division = keep_whole(len(loop))
        vertices = np.concatenate([loop, count + np.arange(len(division.points))])
        for number, section in enumerate(division.sections):
            part = section.outline[parts[hole][number]] if hole in parts else cap.triangles
            triangles.append(vertices[part].astype(np.int32))
            patches.append(np.full(len(part), len(holes)))
            holes.append(hole)
            patch_planes.append(section.plane)
            lengths.append(edge_lengths[hole])
        points.append(division.points)
        crease_planes.append(division.point_planes)
        count += len(division.points)
    cap_mesh = CapMesh(
        np.concatenate(points), np.concatenate(triangles), np.concatenate(patches), np.array(holes), count
    )
    caps = Caps(around, cap_mesh, np.array(patch_planes), np.concatenate(crease_planes))
    return _place_vertices(caps, planes, np.array(lengths), rim_edges)


def _find_rim_edges(around: Surroundings) -> Ids:
    """Return the edges (e, 2) of the mesh between rim vertices, the smaller vertex first."""
    is_rim = np.zeros(len(around.points), bool)
    is_rim[np.concatenate(around.loops)] = True
    ends = build_edges(around.triangles, len(around.points)).ends
    return ends[is_rim[ends].all(axis=1)]


def _triangulate_sections(
    around: Surroundings, divided: Sequence[DividedCap | None], existing: Ids
) -> dict[int, list[Triangles]]:
    """Triangulate the sections of caps with several sections.

    Parameters
    ----------
    existing : keys of the edges of the mesh between rim vertices, ascending.

    Returns
    -------
    Triangles of each section, as positions in its outline, by hole. Holes are missing if a section cannot be
    triangulated.
    """
    points, outlines, owners, forbidden = [around.points], [], [], [existing]
    count = len(around.points)
    for hole, (loop, division) in enumerate(zip(around.loops, divided, strict=True)):
        if division is None or len(division.sections) == 1:
            continue
        vertices = np.concatenate([loop, count + np.arange(len(division.points))])
        # No chord may connect two vertices of a crease: both sections at the crease could have it.
        chords = [
            make_edge_keys(*vertices[crease][np.stack(np.triu_indices(len(crease), 1))])
            for crease in division.creases
        ]
        if any(len(keys) == 1 and is_known_key(keys, existing).any() for keys in chords):
            continue
        outlines += [vertices[section.outline] for section in division.sections]
        owners += [hole] * len(division.sections)
        forbidden += chords
        points.append(division.points)
        count += len(division.points)
    is_possible = [len(outline) >= 3 for outline in outlines]
    found = iter(
        triangulate_loops(
            np.concatenate(points),
            [outline for outline, possible in zip(outlines, is_possible, strict=True) if possible],
            np.sort(np.concatenate(forbidden)),
        )
    )
    parts: dict[int, list[Triangles | None]] = {}
    for hole, possible in zip(owners, is_possible, strict=True):
        parts.setdefault(hole, []).append(next(found) if possible else None)
    return {
        hole: [one for one in own if one is not None]
        for hole, own in parts.items()
        if all(one is not None for one in own)
    }


def _place_vertices(caps: Caps, planes: Planes, lengths: Floats, rim_edges: Ids) -> Caps:
    """Remesh the caps, and place their vertices on planes or on smooth continuations."""
    cap_mesh, given = caps.cap_mesh, len(caps.around.points)
    for _ in range(_FAIRING_ITERATIONS):
        cap_mesh = remesh_caps(cap_mesh, lengths, rim_edges)
        points = cap_mesh.points.copy()
        plane_of = _find_planes(cap_mesh, caps.planes)
        free = np.arange(cap_mesh.fixed_count, len(points))
        planar, smooth = free[plane_of[free] >= 0], free[plane_of[free] < 0]
        points[planar] = planes.project(points[planar], plane_of[planar])
        if len(smooth):
            own = cap_mesh.triangles[caps.planes[cap_mesh.patches] < 0]
            triangles = np.concatenate([own, caps.around.triangles])
            points[smooth] = fair(points, triangles, np.unique(own[own < given]), smooth)
        cap_mesh = replace(cap_mesh, points=points)
    return replace(caps, cap_mesh=cap_mesh)


def _find_planes(cap_mesh: CapMesh, patch_planes: Ids) -> Ids:
    """Return the plane of each free vertex; −1 for none, and for all others."""
    found = np.full(len(cap_mesh.points), -1, np.int64)
    found[cap_mesh.triangles] = patch_planes[cap_mesh.patches][:, None]
    found[: cap_mesh.fixed_count] = -1
    return found
