"""Closing of all borders: on the plane where the object stood, by smooth caps, or by thickening a sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.codes import CLEAN_NOT_SOLID
from scanloom.stages.cleaning.solids.booleans import require_manifold3d
from scanloom.stages.cleaning.solids.shell import Shell, compute_volumes
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.surface.cap_fairing import fair
from scanloom.stages.surface.cap_remeshing import CapMesh, remesh_caps
from scanloom.stages.surface.cross_products import compute_area_vectors
from scanloom.stages.surface.edges import Ids, build_edges, label_components, make_edge_keys
from scanloom.stages.surface.hole_filling import trace_border_loops
from scanloom.stages.surface.loop_triangulation import triangulate_loops
from scanloom.stages.surface.mesh import Mesh, Triangles, Vertices
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.topology import compute_areas

# Loops with more edges are triangulated coarsely first: time grows with the cube of the edge count.
_MAX_LOOP_EDGES = 300
# A component is an object if its caps enclose a volume, seen from outside. 36 π V² / A³ is 1 for a sphere.
# Closed with caps, objects have 0.02 to 0.5; walls, rooms and single views have less than 0.005, or a
# negative volume.
_MIN_COMPACTNESS = 0.01
# With a smaller ratio of the surface, sheets may be debris, and the message says how to remove them.
_MAX_REMOVABLE_RATIO = 0.2
# A border on which the object stood: nine tenths of its vertices are within this ratio of the object's height
# above the lowest point, and at least this ratio of the object's cross-section area is inside of it.
_MAX_RIM_HEIGHT_RATIO = 0.2
_MIN_BASE_AREA_RATIO = 0.05
# Minimum cosine between the normals of two borders on the same plane.
_MIN_BASE_COSINE = 0.7
# Gap between the lowest point and the base plane, in median edge lengths; without it, triangles of the base
# would have no area.
_BASE_GAP = 0.05
# Edge length of the base, in median edge lengths.
_BASE_EDGES = 4.0
# A wall has at most this ratio of the free distance behind the surface, so that walls from opposite sides
# never meet; and at creases at most this multiple of the wall thickness.
_MAX_FREE_RATIO, _MAX_MITER = 0.45, 2.0


@dataclass(frozen=True)
class ClosingCounts:
    """Counts of closed borders, by method.

    Attributes
    ----------
    base_borders : borders closed on the plane where the object stood.
    capped_borders : other borders closed by caps.
    thickened_sheets : connected components that became a wall.
    """

    base_borders: int
    capped_borders: int
    thickened_sheets: int


@dataclass(frozen=True, eq=False)
class BasePlane:
    """Known plane on which an object stood.

    Attributes
    ----------
    normal : (3,) unit normal that points to the object.
    offset_m : dot product of the normal and the points of the plane.
    reach_m : a border is closed on the plane if one of its vertices is within this height above the plane.
    """

    normal: NDArray[np.float64]
    offset_m: float
    reach_m: float


def close_borders(
    mesh: Mesh, wall: float, edge_length: float, base_plane: BasePlane | None = None
) -> tuple[Shell, ClosingCounts]:
    """Close all borders of an oriented manifold.

    Parameters
    ----------
    wall : thickness of walls that are made of sheets, metres; 0 to refuse sheets.
    edge_length : edge length of caps, metres.
    base_plane : plane on which the object stood; None to fit a plane to the borders.

    Raises
    ------
    MeshError
        If a component encloses no volume, and `wall` is 0.
    """
    shell = Shell(mesh.vertices, mesh.triangles, np.arange(len(mesh.triangles)))
    edges = build_edges(mesh.triangles, len(mesh.vertices))
    loops, _ = trace_border_loops(mesh, edges)
    if not loops:
        return shell, ClosingCounts(0, 0, 0)
    count, labels = label_components(len(mesh.vertices), edges.ends[:, 0], edges.ends[:, 1])
    gap = max(_BASE_GAP * edge_length, wall)
    if base_plane is None:
        base, capped = _split_base_loops(mesh, loops, labels)
    else:
        base, capped, gap = *select_base_loops(mesh, loops, base_plane), 0.0
    closures: list[_Closure] = [
        (
            np.concatenate(own),
            *_make_base([mesh.vertices[loop] for loop in own], normal, offset + gap, edge_length),
        )
        for own, normal, offset in base
    ]
    closures += [(loop, *_make_cone(mesh.vertices[loop])) for loop in capped]
    sheets = _find_sheets(mesh, closures, labels, count)
    if sheets.any() and wall == 0:
        _refuse_sheet(mesh, sheets, labels)
    is_sheet = sheets[labels[mesh.triangles[:, 0]]]
    points, triangles = [mesh.vertices], [mesh.triangles]
    if is_sheet.any():
        back = _make_walls(mesh, is_sheet, wall)
        points.append(back.vertices)
        triangles.append(back.triangles)
    number = sum(len(one) for one in points)
    bottoms = [one for one in closures[: len(base)] if not sheets[labels[one[0][0]]]]
    for loop, own_points, own_triangles in bottoms:
        index = np.concatenate([loop, number + np.arange(len(own_points))])
        points.append(own_points)
        triangles.append(index[own_triangles].astype(np.int32))
        number += len(own_points)
    capped = [loop for loop in capped if not sheets[labels[loop[0]]]]
    if capped:
        own_points, own_triangles = make_caps(mesh, capped, edge_length)
        triangles.append(
            np.where(
                own_triangles < len(mesh.vertices), own_triangles, own_triangles - len(mesh.vertices) + number
            ).astype(np.int32)
        )
        points.append(own_points)
    joined = np.concatenate(triangles)
    source = np.full(len(joined), -1)
    source[: len(mesh.triangles)] = np.arange(len(mesh.triangles))
    counts = ClosingCounts(len(bottoms), len(capped), int(sheets.sum()))
    return Shell(np.concatenate(points), joined.astype(np.int32), source), counts


_Closure = tuple[Ids, Vertices, Triangles]
# Borders that a base joins, the outer one first, and the normal and the offset of its plane.
_Base = tuple[list[Ids], NDArray[np.float64], float]


def _find_sheets(mesh: Mesh, closures: Sequence[_Closure], labels: Ids, count: int) -> NDArray[np.bool_]:
    """Return a mask (count,) of the open components that enclose too little volume when closed.

    A closure is a border, added points, and triangles as positions in both.
    """
    component = labels[mesh.triangles[:, 0]]
    center = mesh.vertices.mean(axis=0)
    vertices = mesh.vertices - center
    volumes = np.bincount(component, compute_volumes(vertices, mesh.triangles), count)
    areas = np.bincount(component, compute_areas(vertices, mesh.triangles), count)
    is_open = np.zeros(count, bool)
    for loop, points, triangles in closures:
        closing = np.concatenate([vertices[loop], points - center])
        row = labels[loop[0]]
        volumes[row] += compute_volumes(closing, triangles).sum()
        areas[row] += compute_areas(closing, triangles).sum()
        is_open[row] = True
    compactness = 36 * np.pi * np.sign(volumes) * volumes**2 / np.maximum(areas**3, np.finfo(float).tiny)
    return np.asarray(is_open & (compactness < _MIN_COMPACTNESS))


def _make_cone(rim: Vertices) -> tuple[Vertices, Triangles]:
    """Return the centre of a border and a fan around it, which stands for a cap."""
    here = np.arange(len(rim))
    fan = np.stack([here, np.roll(here, -1), np.full(len(rim), len(rim))], axis=1)
    return rim.mean(axis=0, keepdims=True), fan.astype(np.int32)


def _refuse_sheet(mesh: Mesh, sheets: NDArray[np.bool_], labels: Ids) -> None:
    component = labels[mesh.triangles[:, 0]]
    areas = np.bincount(component, compute_areas(mesh.vertices, mesh.triangles), len(sheets))
    first = int(mesh.triangles[np.flatnonzero(sheets[component])[0], 0])
    x, y, z = mesh.vertices[first].tolist()
    ratio = float(areas[sheets].sum() / areas.sum())
    remedy = "set clean.wall to the thickness in metres of the wall behind them"
    if ratio < _MAX_REMOVABLE_RATIO:
        remedy += f", or clean.min_island_area to more than {areas[sheets].max():.3g} m² to remove them"
    raise MeshError(
        CLEAN_NOT_SOLID,
        "open sheets, which enclose no volume, are {ratio:.1%} of the surface, one at ({x:.6g}, {y:.6g}, "
        "{z:.6g}) m",
        "mesh",
        remedy=f"{remedy}.",
        ratio=ratio,
        x=x,
        y=y,
        z=z,
    )


def _make_walls(mesh: Mesh, chosen: NDArray[np.bool_], wall: float) -> Shell:
    """Return the back and the rims of walls behind triangles, a mask (m,).

    The vertices of the back are numbered after those of the mesh.
    """
    triangles = mesh.triangles[chosen]
    used, own = np.unique(triangles, return_inverse=True)
    own = own.reshape(-1, 3)
    back_points = mesh.vertices[used] + _compute_offsets(mesh, mesh.vertices[used], own, wall)
    number = np.zeros(len(mesh.vertices), np.int64)
    number[used] = len(mesh.vertices) + np.arange(len(used))
    edges = build_edges(triangles, len(mesh.vertices))
    border = edges.halfedges[edges.start[edges.triangle_count == 1]]
    corners = triangles.reshape(-1)
    tail, head = corners[border], corners[border // 3 * 3 + (border + 1) % 3]
    rims = [
        np.stack([head, tail, number[tail]], axis=1),
        np.stack([head, number[tail], number[head]], axis=1),
    ]
    back = number[triangles[:, ::-1]]
    rows = np.concatenate([back, *rims]).astype(np.int32)
    return Shell(back_points, rows, np.full(len(rows), -1))


def _compute_offsets(mesh: Mesh, points: Vertices, triangles: Ids, wall: float) -> Vertices:
    """Compute offsets (n, 3) to the back of a wall, so that it has its thickness behind each triangle.

    The offset of a vertex solves, in least squares, that each triangle around it moves by `wall` along its
    normal.
    """
    vectors = compute_area_vectors(points[triangles])
    areas = np.linalg.norm(vectors, axis=1)
    normals = vectors / np.maximum(areas, np.finfo(float).tiny)[:, None]
    matrix, right = np.zeros((len(points), 3, 3)), np.zeros((len(points), 3))
    for corner in range(3):
        np.add.at(matrix, triangles[:, corner], areas[:, None, None] * normals[:, :, None] * normals[:, None])
        np.add.at(right, triangles[:, corner], -wall * areas[:, None] * normals)
    trace = np.trace(matrix, axis1=1, axis2=2)[:, None, None]
    # The regularization keeps offsets in a plane along its normal.
    matrix = matrix + (0.05 * trace + np.finfo(float).tiny) * np.eye(3)
    offsets = np.linalg.solve(matrix, 1.05 * right[:, :, None])[:, :, 0]
    lengths = np.linalg.norm(offsets, axis=1)
    directions = offsets / np.maximum(lengths, np.finfo(float).tiny)[:, None]
    lengths = np.minimum(lengths, _MAX_MITER * wall)
    start = 1e-5 * float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    hits = RaycastingSurface(mesh).cast_rays(points + start * directions, directions)
    free = np.full(len(points), np.inf)
    leaves = np.einsum("ij,ij->i", hits.normals, directions[hits.rays]) > 0
    free[hits.rays[leaves]] = hits.distances[leaves] + start
    return np.asarray(np.minimum(lengths, _MAX_FREE_RATIO * free)[:, None] * directions)


def _split_base_loops(mesh: Mesh, loops: Sequence[Ids], labels: Ids) -> tuple[list[_Base], list[Ids]]:
    """Split borders into those on which an object stood, with their planes, and all others.

    A plane is given by its outward normal and the offset along the normal.
    """
    base, others = [], []
    component = np.array([labels[loop[0]] for loop in loops], np.int64)
    for row in np.unique(component).tolist():
        own = [loop for loop, of in zip(loops, component.tolist(), strict=True) if of == row]
        points = mesh.vertices[np.unique(mesh.triangles[labels[mesh.triangles[:, 0]] == row])]
        vectors = np.array([_compute_area_vector(mesh.vertices[loop]) for loop in own])
        sizes = np.linalg.norm(vectors, axis=1)
        normal = _fit_plane_normal(mesh.vertices[own[int(sizes.argmax())]], vectors[sizes.argmax()])
        heights = points @ normal
        height = float(np.ptp(heights))
        across = np.ptp(points @ np.linalg.svd(normal[None])[2][1:].T, axis=0).prod()
        offset = float(heights.max())
        for loop, vector, size in zip(own, vectors, sizes, strict=True):
            is_base = (
                sizes.max() >= _MIN_BASE_AREA_RATIO * across
                and float(vector @ normal) >= _MIN_BASE_COSINE * size
                and offset - float(np.quantile(mesh.vertices[loop] @ normal, 0.1))
                <= _MAX_RIM_HEIGHT_RATIO * height
            )
            if is_base:
                base.append(([loop], normal, offset))
            else:
                others.append(loop)
    return base, others


def select_base_loops(mesh: Mesh, loops: Sequence[Ids], plane: BasePlane) -> tuple[list[_Base], list[Ids]]:
    """Split borders into those on a known plane, with the plane, and all others.

    A border that leaves the plane, as at the unseen back of an object, is continued vertically to the plane.
    A border around a hole of an object, such as a ring, belongs to the base of the border around it.
    """
    outer: list[list[Ids]] = []
    inner: list[Ids] = []
    others: list[Ids] = []
    across = np.linalg.svd(plane.normal[None])[2][1:].T
    for loop in loops:
        points = mesh.vertices[loop]
        heights = points @ plane.normal - plane.offset_m
        if heights.min() > plane.reach_m:
            others.append(loop)
        elif _compute_area_vector(points) @ plane.normal < 0:
            outer.append([loop])
        else:
            inner.append(loop)
    areas = [abs(_compute_area_vector(mesh.vertices[own[0]]) @ plane.normal) for own in outer]
    for loop in inner:
        point = mesh.vertices[loop[0]] @ across
        around = [row for row, own in enumerate(outer) if _contains(mesh.vertices[own[0]] @ across, point)]
        if around:
            outer[min(around, key=lambda row: areas[row])].append(loop)
        else:
            others.append(loop)
    return [(own, -plane.normal, -plane.offset_m) for own in outer], others


def _contains(polygon: NDArray[np.float64], point: NDArray[np.float64]) -> bool:
    """Return True if a polygon (k, 2) winds around a point, by counting crossings of a ray."""
    start, end = polygon - point, np.roll(polygon, -1, axis=0) - point
    crosses = (start[:, 1] > 0) != (end[:, 1] > 0)
    start, end = start[crosses], end[crosses]
    x = start[:, 0] - start[:, 1] * (end[:, 0] - start[:, 0]) / (end[:, 1] - start[:, 1])
    return bool(np.count_nonzero(x > 0) % 2)


def _compute_area_vector(points: Vertices) -> NDArray[np.float64]:
    offsets = points - points[0]
    return np.asarray(np.cross(offsets, np.roll(offsets, -1, axis=0)).sum(axis=0) / 2)


def _fit_plane_normal(points: Vertices, direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the unit normal of the plane of a border that points into a direction."""
    normal = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][2]
    return np.asarray(-normal if normal @ direction < 0 else normal)


def _make_base(
    rims: Sequence[Vertices], normal: NDArray[np.float64], offset: float, edge_length: float
) -> tuple[Vertices, Triangles]:
    """Return the vertices of a base, and its triangles as positions in the rims and these vertices.

    The base is the projection of the rims on the plane, joined to each rim by a wall.
    """
    points, bottom = triangulate_base(rims, normal, offset, edge_length)
    sizes = [len(rim) for rim in rims]
    count = sum(sizes)
    walls = []
    for start, size in zip(np.cumsum([0, *sizes]).tolist(), sizes, strict=False):
        here = start + np.arange(size)
        ahead = np.roll(here, -1)
        walls += [
            np.stack([here, ahead, ahead + count], axis=1),
            np.stack([here, ahead + count, here + count], axis=1),
        ]
    return points, np.concatenate([*walls, bottom + count]).astype(np.int32)


def triangulate_base(
    rims: Sequence[Vertices], normal: NDArray[np.float64], offset: float, edge_length: float
) -> tuple[Vertices, Triangles]:
    """Triangulate the projection of rims on a plane; all but the first are around holes.

    Returns
    -------
    Points on the plane, first those of the rims in order; triangles as positions in the points.
    """
    points = project_on_plane(np.concatenate(rims), normal, offset)
    count = len(points)
    if len(rims) == 1:
        added, bottom = _triangulate_loop(points)
    else:
        across = np.linalg.svd(normal[None])[2][1:]
        if np.linalg.det(np.concatenate([across, normal[None]])) < 0:
            across = across[::-1]
        flat = np.split(points @ across.T, np.cumsum([len(rim) for rim in rims])[:-1])
        added = np.zeros((0, 3))
        bottom = np.asarray(require_manifold3d().triangulate(flat)).astype(np.int32)
    # Small triangles keep the repair of a base that intersects itself local.
    bottom_mesh = remesh_caps(
        CapMesh(
            np.concatenate([points, added]),
            bottom,
            np.zeros(len(bottom), np.int64),
            np.zeros(1, np.int64),
            count,
        ),
        np.array([_BASE_EDGES * edge_length]),
        np.zeros((0, 2), np.int64),
    )
    return bottom_mesh.points, bottom_mesh.triangles


def project_on_plane(points: Vertices, normal: NDArray[np.float64], offset: float) -> Vertices:
    """Project points (n, 3) on the plane of the points x with normal · x = offset."""
    return np.asarray(points + (offset - points @ normal)[:, None] * normal)


def _triangulate_loop(points: Vertices, taken: Ids | None = None) -> tuple[Vertices, Triangles]:
    """Triangulate a closed loop of points with small area; return added points and triangles.

    A long loop is triangulated between every k-th vertex first; the chains between these follow. A loop that
    has no such triangulation becomes a fan around an added point.

    Parameters
    ----------
    taken : edge keys of positions, ascending, that are edges already.
    """
    count = len(points)
    step = -(-count // _MAX_LOOP_EDGES)
    taken = np.zeros(0, np.int64) if taken is None else taken
    # Other anchors help if the chain between two anchors is straight, so that it has no triangles.
    for phase in range(step):
        anchors = np.arange(phase, count, step)
        ends = [*anchors[1:].tolist(), phase + count]
        chains = [np.arange(a, b + 1) % count for a, b in zip(anchors.tolist(), ends, strict=True)]
        loops = [anchors, *(chain for chain in chains if len(chain) > 2)]
        parts = triangulate_loops(points, loops, taken)
        rows = [loop[part] for loop, part in zip(loops, parts, strict=True) if part is not None]
        if len(rows) == len(loops):
            return np.zeros((0, 3)), np.concatenate(rows).astype(np.int32)
    return _make_cone(points)


def make_caps(mesh: Mesh, loops: Sequence[Ids], edge_length: float) -> tuple[Vertices, Triangles]:
    """Return the new vertices of smooth caps, and the triangles in the numbering of mesh and new vertices."""
    is_rim = np.zeros(len(mesh.vertices), bool)
    is_rim[np.concatenate(loops)] = True
    around = mesh.triangles[is_rim[mesh.triangles].any(axis=1)]
    edges = build_edges(around, len(mesh.vertices))
    rim_edges = edges.ends[is_rim[edges.ends].all(axis=1)]
    points, pieces, patches = [mesh.vertices], [], []
    position = np.full(len(mesh.vertices), -1)
    count = len(mesh.vertices)
    for row, loop in enumerate(loops):
        position[:] = -1
        position[loop] = np.arange(len(loop))
        inside = position[rim_edges]
        inside = inside[(inside >= 0).all(axis=1)]
        added, part = _triangulate_loop(mesh.vertices[loop], np.sort(make_edge_keys(*inside.T)))
        pieces.append(np.append(loop, count)[part])
        patches.append(np.full(len(part), row))
        points.append(added)
        count += len(added)
    caps = CapMesh(
        np.concatenate(points),
        np.concatenate(pieces).astype(np.int32),
        np.concatenate(patches),
        np.arange(len(loops)),
        len(mesh.vertices),
    )
    lengths = [
        max(edge_length, float(np.linalg.norm(np.diff(mesh.vertices[loop], axis=0), axis=1).mean()))
        for loop in loops
    ]
    caps = remesh_caps(caps, np.array(lengths), rim_edges)
    free = np.arange(len(mesh.vertices), len(caps.points))
    placed = caps.points.copy()
    if len(free):
        placed[free] = fair(placed, np.concatenate([caps.triangles, around]), np.concatenate(loops), free)
        placed = _keep_unfolded(caps, placed)
    return placed[free], caps.triangles


def _keep_unfolded(caps: CapMesh, points: Vertices) -> Vertices:
    """Undo the fairing of caps that it folds: where a triangle turns by more than 90°."""
    before = compute_area_vectors(caps.points[caps.triangles])
    after = compute_area_vectors(points[caps.triangles])
    folded = np.unique(caps.patches[(before * after).sum(axis=1) <= 0])
    rows = np.unique(caps.triangles[np.isin(caps.patches, folded)])
    kept = points.copy()
    kept[rows] = caps.points[rows]
    return np.asarray(kept)
