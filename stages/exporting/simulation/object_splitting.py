"""Division of a scan into the objects that stand on its floors and tables, and the rest.

Fusion joins objects to the surface on which they stand. The mesh is cut slightly above each support plane,
and connected components above the cut are objects, if they enclose a volume when they are closed by the
plane. Walls do not: they are seen from inside. The plane is then flattened and closed where objects stood.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.clean import clean
from scanloom.stages.cleaning.codes import CLEAN_NOT_SOLID
from scanloom.stages.cleaning.solid import make_solid
from scanloom.stages.cleaning.solids.attributes import transfer_attributes
from scanloom.stages.cleaning.solids.border_closing import (
    BasePlane,
    project_on_plane,
    select_base_loops,
    triangulate_base,
)
from scanloom.stages.cleaning.solids.shell import Shell, join_shells
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.exporting.simulation.collision_proof import SolidDistance, measure_diagonal
from scanloom.stages.exporting.simulation.convex_part import build_outline
from scanloom.stages.exporting.simulation.plane_cut import cut_along_plane
from scanloom.stages.exporting.simulation.solid import build_solid
from scanloom.stages.exporting.simulation.support_planes import LevelPlane, find_support_planes
from scanloom.stages.surface.edges import Ids, build_edges, label_components
from scanloom.stages.surface.hole_filling import trace_border_loops
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.topology import compute_areas, has_repeated_vertex

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

# Vertices closer to the cut than this ratio of its height count as on the cut, so that no slivers result.
_SNAP_RATIO = 0.02
# Minimum height and width of an object, as multiples of the height of the cut. Smaller components are crumbs.
_MIN_SIZE_RATIO = 3.0
# A component without contact may hover above the plane by this ratio of its height: cameras do not see the
# lower part of objects.
_MAX_GAP_RATIO = 0.25
# A component that contains this ratio of another support plane is furniture.
_MIN_FURNITURE_RATIO = 0.2
# Maximum distance by which self-intersecting surface of an object may move, per diagonal of the object. A
# simplified mesh has long edges, from which no distance can be derived.
_MAX_SHAPE_RATIO = 0.02
# Components without volume that are inside of an object, or this near to it relative to its diagonal, are
# torn parts of it. As static surface they would hold the object.
_NEAR_RATIO = 0.05
# Minimum height of a component on an object, as a ratio of the height of both.
_MIN_STACKED_RATIO = 0.2
# Objects start this far above their plane, as a ratio of the diagonal of the scan, so that bodies do not
# overlap by rounding.
_LIFT_RATIO = 1e-5


@dataclass(frozen=True, eq=False)
class ScannedObject:
    """Object that stands on a plane.

    Attributes
    ----------
    mesh : closed surface with the colours and texture of the scan; added surface has its own material.
    plane : plane on which the object stands.
    bottom_m : offset of the base of the object along the normal of the plane.
    volume_m3 : enclosed volume.
    added_ratio : area of added surface, relative to the area of the closed surface.
    stacked : number of components that stand on a level face of the object.
    is_sound : the closed surface does not intersect itself, and contains all of the scanned surface.
    """

    mesh: Mesh
    plane: LevelPlane
    bottom_m: float
    volume_m3: float
    added_ratio: float
    stacked: int
    is_sound: bool


@dataclass(frozen=True, eq=False)
class DividedScan:
    """Objects of a scan and the rest.

    Attributes
    ----------
    objects : the objects, the one with the largest volume first.
    rest : surface that is not part of an object, closed where objects stood.
    planes : support planes.
    crumbs : number of components above a plane that are too small.
    sheets : number of components on a plane that enclose no volume, such as walls.
    furniture : number of components on a plane that carry another support plane or reach below the plane.
    torn : number of components without volume that are left out, because they are inside of an object or next
        to it.
    flattened_m : largest distance by which the surface of a plane was moved.
    """

    objects: tuple[ScannedObject, ...]
    rest: Mesh
    planes: tuple[LevelPlane, ...]
    crumbs: int
    sheets: int
    furniture: int
    torn: int
    flattened_m: float


def divide_scan(mesh: Mesh) -> DividedScan:
    """Divide a z-up mesh into objects on its support planes and the rest.

    Raises
    ------
    UsageError
        If `manifold3d` is not installed.
    """
    rest = clean(mesh, min_island_area=0.0).mesh
    lift = _LIFT_RATIO * float(np.linalg.norm(np.ptp(rest.vertices, axis=0)))
    done: list[_PlaneDivision] = []
    planes = find_support_planes(rest)
    while pending := [one for one in planes if not any(one.is_same(other.plane) for other in done)]:
        # The highest plane first: objects on a table are not part of the table.
        plane = max(pending, key=lambda one: one.offset_m)
        known = [one for own in done for one in own.objects]
        division = _divide_at_plane(rest, plane, [one for one in planes if one is not plane], known, lift)
        done.append(division)
        if division.rest is not rest:
            rest = division.rest
            planes = find_support_planes(rest)
    objects = sorted((one for own in done for one in own.objects), key=lambda one: -one.volume_m3)
    left = sum((own.left for own in done), Counter[str]())
    return DividedScan(
        objects=tuple(objects),
        rest=rest,
        planes=tuple(own.plane for own in done),
        crumbs=left["crumbs"],
        sheets=left["sheets"],
        furniture=left["furniture"],
        torn=left["torn"],
        flattened_m=max((own.flattened_m for own in done), default=0.0),
    )


@dataclass(eq=False)
class _PlaneDivision:
    """Objects on one plane, and the number of other components by kind; see `DividedScan`."""

    plane: LevelPlane
    rest: Mesh
    objects: list[ScannedObject] = field(default_factory=list)
    left: Counter[str] = field(default_factory=Counter)
    flattened_m: float = 0.0


@dataclass(frozen=True, eq=False)
class _CutMesh:
    """Mesh cut above a plane.

    Attributes
    ----------
    shell : cut triangles, with their triangles in the given mesh.
    heights : (n,) heights of the vertices above the plane, metres.
    on_cut : (n,) vertices on the cut.
    zone : (m,) triangles of the plane: connected surface below the cut.
    in_zone : (n,) vertices of these triangles.
    """

    shell: Shell
    heights: Floats
    on_cut: Mask
    zone: Mask
    in_zone: Mask


def _divide_at_plane(
    mesh: Mesh,
    plane: LevelPlane,
    others: Sequence[LevelPlane],
    known: Sequence[ScannedObject],
    lift_m: float,
) -> _PlaneDivision:
    cut = _cut_above(mesh, plane)
    shell, division = cut.shell, _PlaneDivision(plane, mesh)
    is_taken = np.zeros(len(shell.triangles), bool)
    caps: list[Shell] = []
    left: list[tuple[Mask, str]] = []
    for chosen in _list_components(cut):
        used = np.unique(shell.triangles[chosen])
        contact = used[cut.in_zone[used]]
        if not _is_above(cut, used, contact, plane):
            # Legs of a table are only below; a shelf that continues above the plane is furniture.
            left.append((chosen, "furniture" if cut.on_cut[contact].any() else ""))
            continue
        size = float(np.ptp(shell.vertices[used], axis=0)[:2].max())
        if min(float(cut.heights[used].max()), size) < _MIN_SIZE_RATIO * plane.reach_m:
            left.append((chosen, "crumbs"))
            continue
        if any(_contains(shell, chosen, mesh, other) for other in others):
            division.left["furniture"] += 1
            continue
        part = shell.select(chosen)
        closed = _close_object(transfer_attributes(part, mesh).mesh, plane, lift_m)
        if closed is None:
            left.append((chosen, "sheets"))
            continue
        division.objects.append(closed[0])
        caps += closed[1]
        is_taken |= chosen
    objects = [
        SolidDistance(build_solid(one.mesh).surface, is_solid=True) for one in (*known, *division.objects)
    ]
    for chosen, kind in left:
        points = shell.vertices[np.unique(shell.triangles[chosen])]
        if any(_is_next_to(points, one) for one in objects):
            division.left["torn"] += 1
            is_taken |= chosen
        elif kind:
            division.left[kind] += 1
    if is_taken.any():
        division.rest, division.flattened_m = _close_plane(mesh, cut, plane, ~is_taken, caps)
    return division


def _is_next_to(points: Floats, solid: SolidDistance) -> bool:
    """Return True if all points are inside of a solid, or near to it."""
    reach = _NEAR_RATIO * solid.diagonal_m
    low, high = solid.corners.min(axis=(0, 1)) - reach, solid.corners.max(axis=(0, 1)) + reach
    if not ((points >= low) & (points <= high)).all():
        return False
    return bool(solid.measure_excess(points).max() <= reach)


def _cut_above(mesh: Mesh, plane: LevelPlane) -> _CutMesh:
    """Cut the surface that is connected to a plane at the height of its reach."""
    heights = plane.measure_heights(mesh.vertices)
    above = heights - plane.reach_m
    above[np.abs(above) <= _SNAP_RATIO * plane.reach_m] = 0.0
    corners = above[mesh.triangles]
    is_near = (corners.min(axis=1) <= 0) & (corners.max(axis=1) >= -2 * plane.reach_m)
    ends = mesh.triangles[is_near]
    _, labels = label_components(len(heights), ends[:, :2].reshape(-1), ends[:, 1:].reshape(-1))
    seeds = np.unique(labels[mesh.triangles[plane.triangles & is_near, 0]])
    connected = is_near & np.isin(labels[mesh.triangles[:, 0]], seeds)
    cut = cut_along_plane(mesh.vertices, mesh.triangles, above, connected)
    zone = connected[cut.parents] & (cut.heights[cut.triangles].max(axis=1) <= 0)
    in_zone = np.zeros(len(cut.vertices), bool)
    in_zone[cut.triangles[zone]] = True
    return _CutMesh(
        Shell(cut.vertices, cut.triangles, cut.parents),
        plane.measure_heights(cut.vertices),
        cut.heights == 0,
        zone,
        in_zone,
    )


def _list_components(cut: _CutMesh) -> Iterator[Mask]:
    """Yield a mask (m,) for each connected component outside of the plane."""
    triangles = cut.shell.triangles
    ends = triangles[~cut.zone]
    _, labels = label_components(len(cut.heights), ends[:, :2].reshape(-1), ends[:, 1:].reshape(-1))
    component = np.where(cut.zone, -1, labels[triangles[:, 0]])
    for label in np.unique(component[~cut.zone]).tolist():
        yield component == label


def _is_above(cut: _CutMesh, used: Ids, contact: Ids, plane: LevelPlane) -> bool:
    """Return True if a component starts at the cut, or hovers closely above the plane."""
    if len(contact):
        return bool(cut.on_cut[contact].all() and cut.heights[used].min() > 0)
    low, high = float(cut.heights[used].min()), float(cut.heights[used].max())
    if not 0 < low <= max(2 * plane.reach_m, _MAX_GAP_RATIO * (high - low)):
        return False
    outline = build_outline(cut.shell.vertices[cut.in_zone, :2])
    points = cut.shell.vertices[used, :2]
    return bool((points @ outline[:, :2].T + outline[:, 2] <= 0).all())


def _contains(shell: Shell, chosen: Mask, mesh: Mesh, plane: LevelPlane) -> bool:
    """Return True if chosen triangles have a good part of another plane's surface."""
    own = chosen & plane.triangles[shell.source]
    area = float(compute_areas(shell.vertices, shell.triangles[own]).sum())
    total = float(compute_areas(mesh.vertices, mesh.triangles[plane.triangles]).sum())
    return area >= _MIN_FURNITURE_RATIO * total


def _close_object(part: Mesh, plane: LevelPlane, lift_m: float) -> tuple[ScannedObject, list[Shell]] | None:
    """Close a component by the plane; return the object and the surface of the plane below the object.

    None for a component that encloses no volume.
    """
    part = clean(part, min_island_area=0.0).mesh
    edges = build_edges(part.triangles, len(part.vertices))
    loops, _ = trace_border_loops(part, edges)
    gap = float(plane.measure_heights(part.vertices).min())
    base_plane = BasePlane(plane.normal, plane.offset_m + lift_m, gap + plane.reach_m / 2)
    edge_length = float(np.median(np.linalg.norm(np.diff(part.vertices[edges.ends], axis=1), axis=2)))
    max_shape = min(edge_length / 2, _MAX_SHAPE_RATIO * measure_diagonal(part.vertices))
    try:
        with collecting(forward=False) as defects:
            solid = make_solid(part, 0.0, max_shape, base_plane)
    except MeshError as error:
        if error.diagnostic.code != CLEAN_NOT_SOLID.name:
            raise
        return None
    area = float(compute_areas(solid.mesh.vertices, solid.mesh.triangles).sum())
    found = ScannedObject(
        mesh=solid.mesh,
        plane=plane,
        bottom_m=base_plane.offset_m,
        volume_m3=solid.result.volume_m3,
        added_ratio=solid.result.added_area_m2 / area,
        stacked=_count_stacked(solid.mesh),
        is_sound=not defects,
    )
    caps = []
    for own, _, _ in select_base_loops(part, loops, base_plane)[0]:
        rims = [part.vertices[loop] for loop in own]
        points, triangles = triangulate_base(rims, -plane.normal, -plane.offset_m, edge_length)
        caps.append(Shell(points, triangles[:, ::-1], np.full(len(triangles), -1)))
    return found, caps


def _count_stacked(closed: Mesh) -> int:
    """Count the components that stand on a level face of a closed object."""
    count, height = 0, float(np.ptp(closed.vertices[:, 2]))
    for plane in find_support_planes(closed):
        cut = _cut_above(closed, plane)
        for chosen in _list_components(cut):
            used = np.unique(cut.shell.triangles[chosen])
            contact = used[cut.in_zone[used]]
            if not len(contact) or not _is_above(cut, used, contact, plane):
                continue
            if float(cut.heights[used].max()) < max(
                _MIN_SIZE_RATIO * plane.reach_m, _MIN_STACKED_RATIO * height
            ):
                continue
            part = cut.shell.select(chosen).mesh
            loops, _ = trace_border_loops(part, build_edges(part.triangles, len(part.vertices)))
            base = BasePlane(plane.normal, plane.offset_m, 1.5 * plane.reach_m)
            bases = select_base_loops(part, loops, base)[0]
            area = sum(_measure_area(part.vertices[own[0], :2]) for own, _, _ in bases)
            # A small level spot of a round object carries nothing.
            count += 0 < area <= plane.area_m2
    return count


def _measure_area(polygon: Floats) -> float:
    x, y = polygon.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def _close_plane(
    mesh: Mesh, cut: _CutMesh, plane: LevelPlane, is_kept: Mask, caps: Sequence[Shell]
) -> tuple[Mesh, float]:
    """Flatten a plane and close it below its objects.

    Returns
    -------
    The surface without the objects, and the largest distance by which it was moved.
    """
    shell = cut.shell
    fixed = np.zeros(len(shell.vertices), bool)
    fixed[shell.triangles[is_kept & ~cut.zone]] = True
    moved = cut.in_zone & ~fixed & (np.abs(cut.heights) <= (1 + _SNAP_RATIO) * plane.reach_m)
    vertices = shell.vertices.copy()
    vertices[moved] = project_on_plane(vertices[moved], plane.normal, plane.offset_m)
    rest = Shell(vertices, shell.triangles, shell.source).select(is_kept)
    joined = join_shells(rest, *caps).weld()
    joined = joined.select(~has_repeated_vertex(joined.triangles))
    closed = transfer_attributes(joined, mesh).mesh
    return clean(closed, min_island_area=0.0).mesh, float(np.abs(cut.heights[moved]).max(initial=0.0))
