"""Closing of holes by continuing the surface, where no frame has seen free space.

1. Triangulate each border loop up to a given length, and remesh the caps to the edge length of the mesh.
2. Continue planes: a cap between vertices of one plane is on that plane; between two planes, it has a
   straight crease where the planes meet. Other caps continue the surface smoothly.
3. Reject caps through which a frame has measured a surface behind, and caps that touch other surface or fold.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.fusion.scene_statistics import DepthNoise
from scanloom.stages.refinement.cap_fairing import fair, interpolate_values
from scanloom.stages.refinement.cap_planes import Planes, Section, divide_cap, fit_planes
from scanloom.stages.refinement.cap_remeshing import CapMesh, Floats, compute_normals, remesh_caps
from scanloom.stages.refinement.free_space import FreeSpaceTest
from scanloom.stages.surface.edges import Edges, Ids, build_edges
from scanloom.stages.surface.hole_filling import LoopCap, find_border_chords, find_caps, triangulate_loop
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas, is_degenerate

# Default limit of the border length, in mean edge lengths.
_DEFAULT_LENGTH_EDGES = 20.0
# Rim vertices up to this many standard deviations or edge lengths from a plane are on the plane.
_PLANE_DEVIATIONS, _PLANE_EDGES = 3.0, 0.25
# Iterations of remeshing and smooth continuation: each one starts from a better shape.
_FAIRING_ITERATIONS = 2
# A measurement that is so many edge lengths behind a cap proves free space.
_FREE_SPACE_EDGES = 2.0
# Maximum part of a cap in free space: single wrong measurements do not keep a large hole open.
_MAX_FREE_RATIO = 0.05
# Minimum cosine between the normals of adjacent triangles (150°), and maximum part of the rim edges that
# may be folded more: noisy rims have folds of their own.
_MIN_FOLD_COSINE, _MAX_FOLDED_RIM_RATIO = -0.866, 0.2
# Minimum distance from other surface in edge lengths. Surface within so many rings of the rim is not tested.
_MIN_CLEARANCE_EDGES, _NEAR_RINGS = 0.7, 4
# Side of the cells for the search of such surface, in distances.
_CELL_REACHES = 8.0
# Vertices or edges that are compared at a time, to limit the memory.
_BATCH_SIZE = 1 << 20
# Deviation of the vertices of a cap relative to the median: as for vertices that no frame measured.
_FILLED_DEVIATION_RATIO = 3.0


@dataclass(frozen=True, eq=False)
class ClosedHoles:
    """Mesh with closed holes.

    Attributes
    ----------
    mesh : vertices and triangles of the caps follow those of the input.
    is_filled : (n,) True for the vertices of caps.
    deviations, plane_ids : (n,) as in `RefinementResult`.
    hole_count : number of closed holes.
    area : area of their caps, m².
    """

    mesh: Mesh
    is_filled: NDArray[np.bool_]
    deviations: Floats
    plane_ids: NDArray[np.int32]
    hole_count: int
    area: float


@dataclass(frozen=True, eq=False)
class _Caps:
    """Caps of a mesh with their holes and planes.

    Attributes
    ----------
    cap_mesh : triangles of all caps.
    holes : (p,) hole of each patch.
    planes : (p,) plane of each patch, −1 for none.
    crease_planes : (c,) plane of each vertex on a crease.
    loops : rim vertices of each hole.
    """

    cap_mesh: CapMesh
    holes: Ids
    planes: Ids
    crease_planes: Ids
    loops: Sequence[Ids]


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
    unchanged = ClosedHoles(mesh, np.zeros(len(mesh.vertices), bool), deviations, plane_ids, 0, 0.0)
    if not len(edges.ends):
        return unchanged
    mean_edge = _measure_mean_edge(mesh, edges)
    limit = _DEFAULT_LENGTH_EDGES * mean_edge if max_length is None else max_length
    found = find_caps(mesh, edges, limit) if limit > 0 else []
    if not found:
        return unchanged
    caps = _shape_caps(mesh, edges, found, plane_ids, deviations, mean_edge)
    is_kept = ~_find_folded(mesh, caps)
    points, normals, owners = _sample_caps(caps)
    is_kept[owners[_find_contacts(mesh, edges, caps, (points, owners), mean_edge)]] = False
    tested = is_kept[owners]
    test = FreeSpaceTest(points[tested], normals[tested], noise, _FREE_SPACE_EDGES * mean_edge)
    if tested.any():
        show_frames(test)
    counts, free_counts = (
        np.bincount(rows, minlength=len(found)) for rows in (owners, owners[tested][test.is_free])
    )
    is_kept &= free_counts <= _MAX_FREE_RATIO * counts
    return _append_caps(unchanged, caps, is_kept) if is_kept.any() else unchanged


def _measure_mean_edge(mesh: Mesh, edges: Edges) -> float:
    """Return the mean length of the edges, metres."""
    lengths = np.empty(len(edges.ends))
    for first in range(0, len(lengths), _BATCH_SIZE):
        ends = mesh.vertices[edges.ends[first : first + _BATCH_SIZE]]
        lengths[first : first + _BATCH_SIZE] = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
    return float(lengths.mean())


def _shape_caps(
    mesh: Mesh, edges: Edges, found: Sequence[LoopCap], plane_ids: Ids, deviations: Floats, mean_edge: float
) -> _Caps:
    """Triangulate, remesh and place the caps of all holes."""
    planes = fit_planes(mesh.vertices, plane_ids, int(plane_ids.max(initial=-1)) + 1)
    tolerances = np.maximum(_PLANE_DEVIATIONS * deviations, _PLANE_EDGES * mean_edge)
    existing = find_border_chords(edges)
    points, triangles, patches = [mesh.vertices], [], []
    holes: list[int] = []
    patch_planes, lengths, crease_planes = [], [], []
    count = len(mesh.vertices)
    for hole, cap in enumerate(found):
        loop, rim = cap.loop, mesh.vertices[cap.loop]
        length = max(mean_edge, float(np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).mean()))
        sections = divide_cap(rim, plane_ids[loop], tolerances[loop], planes, length)
        parts = _triangulate_sections(mesh, loop, sections, count, existing) if len(sections) > 1 else None
        if parts is None:
            plane = sections[0].plane if len(sections) == 1 else -1
            sections, parts = [Section(plane, 0, len(loop) - 1, np.empty((0, 3)))], [loop[cap.triangles]]
        for section, part in zip(sections, parts, strict=True):
            triangles.append(part.astype(np.int32))
            patches.append(np.full(len(part), len(holes)))
            holes.append(hole)
            patch_planes.append(section.plane)
            lengths.append(length)
        crease = sections[-1].crease
        points.append(crease)
        crease_planes.append(np.full(len(crease), sections[0].plane))
        count += len(crease)
    cap_mesh = CapMesh(np.concatenate(points), np.concatenate(triangles), np.concatenate(patches), count)
    caps = _Caps(
        cap_mesh,
        np.array(holes),
        np.array(patch_planes),
        np.concatenate(crease_planes),
        [cap.loop for cap in found],
    )
    return _place_vertices(mesh, edges, caps, planes, np.array(lengths))


def _triangulate_sections(
    mesh: Mesh, loop: Ids, sections: Sequence[Section], first_new: int, existing: set[tuple[int, int]]
) -> list[Ids] | None:
    """Triangulate both planar parts of a cap, from vertices of the loop and of the crease.

    Parameters
    ----------
    first_new : number of the first vertex of the crease of the last section.

    Returns
    -------
    None if a part cannot be triangulated.
    """
    crease = sections[-1].crease
    line = first_new + np.arange(len(crease))
    # No chord may connect two vertices of the crease: both parts could have it.
    ends = np.concatenate([loop[[sections[-1].end]], line, loop[[sections[-1].start]]])
    chords = {(min(a, b), max(a, b)) for a in ends.tolist() for b in ends.tolist() if a != b}
    if len(line) == 0 and chords & existing:
        return None
    existing = existing | chords
    parts = []
    for section in sections:
        stop = section.end + (len(loop) if section.end < section.start else 0)
        rim = loop[np.arange(section.start, stop + 1) % len(loop)]
        vertices = np.concatenate([rim, line if section is sections[-1] else line[::-1]])
        positions = np.concatenate([mesh.vertices[rim], section.crease])
        part = triangulate_loop(positions, vertices, existing) if len(vertices) >= 3 else None
        if part is None:
            return None
        parts.append(vertices[part])
    return parts


def _place_vertices(mesh: Mesh, edges: Edges, caps: _Caps, planes: Planes, lengths: Floats) -> _Caps:
    """Remesh the caps, and place their vertices on planes or on smooth continuations."""
    is_rim = np.zeros(len(mesh.vertices), bool)
    is_rim[np.concatenate(caps.loops)] = True
    around = mesh.triangles[is_rim[mesh.triangles].any(axis=1)]
    # Only vertices of the caps and around them take part; the mesh is much larger.
    given = caps.cap_mesh
    used = np.unique(np.concatenate([given.triangles.ravel(), around.ravel()]))
    around, taken, triangles = (
        np.searchsorted(used, some).astype(np.int32)
        for some in (around, edges.ends[is_rim[edges.ends].all(axis=1)], given.triangles)
    )
    mesh_count = int(np.searchsorted(used, len(mesh.vertices)))
    cap_mesh = CapMesh(given.points[used], triangles, given.patches, len(used))
    for _ in range(_FAIRING_ITERATIONS):
        cap_mesh = remesh_caps(cap_mesh, lengths, taken)
        points = cap_mesh.points.copy()
        plane_of = _find_planes(cap_mesh, caps.planes)
        free = np.arange(cap_mesh.fixed_count, len(points))
        planar, smooth = free[plane_of[free] >= 0], free[plane_of[free] < 0]
        points[planar] = planes.project(points[planar], plane_of[planar])
        if len(smooth):
            own = cap_mesh.triangles[caps.planes[cap_mesh.patches] < 0]
            points[smooth] = fair(
                points, np.concatenate([own, around]), np.unique(own[own < mesh_count]), smooth
            )
        cap_mesh = CapMesh(points, cap_mesh.triangles, cap_mesh.patches, cap_mesh.fixed_count)
    created = cap_mesh.points[len(used) :]
    numbers = np.concatenate([used, given.fixed_count + np.arange(len(created))])
    placed = CapMesh(
        np.concatenate([given.points, created]),
        numbers[cap_mesh.triangles].astype(np.int32),
        cap_mesh.patches,
        given.fixed_count,
    )
    return _Caps(placed, caps.holes, caps.planes, caps.crease_planes, caps.loops)


def _find_planes(cap_mesh: CapMesh, patch_planes: Ids) -> Ids:
    """Return the plane of each free vertex; −1 for none, and for all others."""
    found = np.full(len(cap_mesh.points), -1, np.int64)
    found[cap_mesh.triangles] = patch_planes[cap_mesh.patches][:, None]
    found[: cap_mesh.fixed_count] = -1
    return found


def _find_folded(mesh: Mesh, caps: _Caps) -> NDArray[np.bool_]:
    """Return a mask of the holes whose cap is folded, or has triangles without area."""
    cap_mesh = caps.cap_mesh
    owners = caps.holes[cap_mesh.patches]
    is_folded = np.zeros(len(caps.loops), bool)
    is_folded[owners[is_degenerate(cap_mesh.points, cap_mesh.triangles)]] = True
    used = np.zeros(len(cap_mesh.points), bool)
    used[cap_mesh.triangles] = True
    around = mesh.triangles[np.count_nonzero(used[mesh.triangles], axis=1) >= 2]
    triangles = np.concatenate([cap_mesh.triangles, around])
    normals = compute_normals(cap_mesh.points, triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    edges = build_edges(triangles, len(cap_mesh.points))
    (paired,) = np.nonzero(edges.triangle_count == 2)
    first, second = (edges.halfedges[edges.start[paired] + k] // 3 for k in (0, 1))
    folds = (normals[first] * normals[second]).sum(axis=1) < _MIN_FOLD_COSINE
    # Triangles of caps come first.
    lower, upper = np.minimum(first, second)[folds], np.maximum(first, second)[folds]
    is_folded[owners[lower[upper < len(owners)]]] = True
    at_rim = (lower < len(owners)) & (upper >= len(owners))
    counts = np.bincount(owners[lower[at_rim]], minlength=len(is_folded))
    return is_folded | (counts > _MAX_FOLDED_RIM_RATIO * np.array([len(loop) for loop in caps.loops]))


def _sample_caps(caps: _Caps) -> tuple[Floats, Floats, Ids]:
    """Sample the caps at centroids and at the middles of edges.

    Returns
    -------
    Points (k, 3), unit normals (k, 3), and the hole (k,) of each.
    """
    cap_mesh = caps.cap_mesh
    corners = cap_mesh.points[cap_mesh.triangles]
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    points = np.concatenate([corners.mean(axis=1), middles.reshape(-1, 3)])
    normals = compute_normals(cap_mesh.points, cap_mesh.triangles)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(np.float64).tiny)
    edges = build_edges(cap_mesh.triangles, len(cap_mesh.points))
    # Middles of rim edges are measured surface; those of inner edges are sampled once.
    inner = edges.halfedges[edges.start[edges.triangle_count == 2]]
    chosen = np.concatenate([np.arange(len(corners)), len(corners) + inner])
    triangles = np.concatenate([np.arange(len(corners)), inner // 3])
    return points[chosen], normals[triangles], caps.holes[cap_mesh.patches][triangles]


def _count_mesh_vertices(caps: _Caps) -> int:
    return caps.cap_mesh.fixed_count - len(caps.crease_planes)


def _find_contacts(
    mesh: Mesh, edges: Edges, caps: _Caps, samples: tuple[Floats, Ids], mean_edge: float
) -> NDArray[np.bool_]:
    """Return a mask of the samples that touch surface other than around their rim, or another cap."""
    from scipy.spatial import cKDTree

    points, owners = samples
    reach = _MIN_CLEARANCE_EDGES * mean_edge
    candidates = _select_near(mesh.vertices, points, reach)
    tree = cKDTree(points)
    contacts = tree.sparse_distance_matrix(
        cKDTree(mesh.vertices[candidates]), reach, output_type="coo_matrix"
    )
    touched, vertices = contacts.row, candidates[contacts.col]
    near = _find_near_vertices(edges, caps.loops, len(mesh.vertices))
    is_other = ~np.isin(owners[touched] * len(mesh.vertices) + vertices, near)
    found = np.zeros(len(points), bool)
    found[touched[is_other]] = True
    between = tree.query_pairs(reach, output_type="ndarray")
    found[between[owners[between[:, 0]] != owners[between[:, 1]]]] = True
    return found


def _select_near(vertices: Floats, points: Floats, reach: float) -> Ids:
    """Select the vertices in cells of a grid that points reach; all within `reach` of a point are among them.

    A search tree of all vertices would take more memory than the mesh.
    """
    low, high = points.min(axis=0) - reach, points.max(axis=0) + reach
    cell = _CELL_REACHES * reach
    shape = tuple(np.floor((high - low) / cell).astype(int) + 1)

    def find_cells(locations: Floats) -> Ids:
        indices = np.floor((locations - low) / cell).astype(np.int64)
        return np.asarray(np.ravel_multi_index(tuple(indices.T), shape))

    corners = [points + reach * np.array(shift) for shift in product((-1, 1), repeat=3)]
    reached = np.unique(np.concatenate([find_cells(some.clip(low, high)) for some in corners]))
    selected = []
    for first in range(0, len(vertices), _BATCH_SIZE):
        batch = vertices[first : first + _BATCH_SIZE]
        (inside,) = np.nonzero(((batch >= low) & (batch <= high)).all(axis=1))
        selected.append(first + inside[np.isin(find_cells(batch[inside]), reached)])
    return np.concatenate(selected)


def _find_near_vertices(edges: Edges, loops: Sequence[Ids], vertex_count: int) -> Ids:
    """Return the vertices within some rings of each rim, as hole · vertex_count + vertex."""
    reached = np.zeros(vertex_count, bool)
    reached[np.concatenate(loops)] = True
    for _ in range(_NEAR_RINGS):
        reached[edges.ends[reached[edges.ends].any(axis=1)]] = True
    ends = edges.ends[reached[edges.ends].all(axis=1)]
    ends = np.concatenate([ends, ends[:, ::-1]])
    ends = ends[np.argsort(ends[:, 0], kind="stable")]
    starts = np.searchsorted(ends[:, 0], np.arange(vertex_count + 1))
    keys = np.concatenate([hole * vertex_count + loop for hole, loop in enumerate(loops)])
    for _ in range(_NEAR_RINGS):
        holes, vertices = np.divmod(keys, vertex_count)
        counts = starts[vertices + 1] - starts[vertices]
        offsets = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        neighbours = ends[np.repeat(starts[vertices], counts) + offsets, 1]
        keys = np.unique(np.concatenate([keys, np.repeat(holes, counts) * vertex_count + neighbours]))
    return keys


def _append_caps(given: ClosedHoles, caps: _Caps, is_kept: NDArray[np.bool_]) -> ClosedHoles:
    """Append the kept caps to the mesh, with colours from the rim."""
    cap_mesh, mesh = caps.cap_mesh, given.mesh
    own = cap_mesh.triangles[is_kept[caps.holes[cap_mesh.patches]]]
    used = np.zeros(len(cap_mesh.points), bool)
    used[own] = True
    count = len(mesh.vertices)
    new = count + np.flatnonzero(used[count:])
    number = np.arange(len(cap_mesh.points))
    number[new] = count + np.arange(len(new))
    plane_of = _find_planes(cap_mesh, caps.planes)
    plane_of[count : cap_mesh.fixed_count] = caps.crease_planes
    colors = mesh.colors
    if colors is not None and len(new):
        padded = np.concatenate([colors, np.zeros((len(cap_mesh.points) - count, 3), np.uint8)])
        values = interpolate_values(cap_mesh.points, own, new, padded)
        colors = np.concatenate([colors, np.rint(values).clip(0, 255).astype(np.uint8)])
    filled = np.full(len(new), _FILLED_DEVIATION_RATIO * float(np.median(given.deviations)))
    return ClosedHoles(
        mesh=Mesh(
            np.concatenate([mesh.vertices, cap_mesh.points[new]]),
            np.concatenate([mesh.triangles, number[own].astype(np.int32)]),
            colors,
            up=mesh.up,
        ),
        is_filled=np.concatenate([given.is_filled, np.ones(len(new), bool)]),
        deviations=np.concatenate([given.deviations, filled]),
        plane_ids=np.concatenate([given.plane_ids, plane_of[new].astype(np.int32)]),
        hole_count=int(np.count_nonzero(is_kept)),
        area=float(compute_areas(cap_mesh.points, own).sum()),
    )
