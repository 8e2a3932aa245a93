"""Making a surface solid: closed, manifold, oriented outwards and free of self-intersections.

1. Close all borders; open sheets become walls, on request. 2. Turn components outwards. 3. Remove
self-intersections. 4. Thicken thin walls, on request. 5. Transfer colours and texture. 6. Prove how far the
existing surface is from the result.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.codes import CLEAN_NOT_SOLID, CLEAN_SOLID_INCOMPLETE, CLEAN_SOLID_THIN
from scanloom.stages.cleaning.solids.attributes import transfer_attributes
from scanloom.stages.cleaning.solids.booleans import require_manifold3d, trim_by_plane
from scanloom.stages.cleaning.solids.border_closing import BasePlane, ClosingCounts, close_borders
from scanloom.stages.cleaning.solids.self_intersections import (
    MAX_LOST_RATIO,
    find_unsound,
    measure_lost_ratio,
    orient_components,
    resolve_intersections,
)
from scanloom.stages.cleaning.solids.shell import Shell, compute_volumes
from scanloom.stages.cleaning.solids.thickening import thicken
from scanloom.stages.cleaning.thickness import measure_thickness
from scanloom.stages.comparing.certify import certify
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.surface.cross_products import compute_area_vectors
from scanloom.stages.surface.edges import Ids, build_edges
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.texture import select_rows
from scanloom.stages.surface.topology import compute_areas

# Default limit of the distance by which self-intersecting surface may move, as a ratio of the median edge
# length. The grid has cells of this size, and its surface is within half a cell.
_MAX_SHAPE_RATIO = 0.5
# A triangle is unchanged if the parts of it in the result have its area, up to rounding.
_AREA_TOLERANCE = 1e-6
# Minimum cosine between a rebuilt triangle and the given surface that it replaces.
_MIN_RESTORED_COSINE = 0.5


@dataclass(frozen=True, eq=False)
class SolidResult:
    """What was done to make a surface solid.

    Attributes
    ----------
    closing : counts of closed borders.
    intersections : how self-intersections were removed: "none" if there were none; "united" if overlapping
        components were united; "refilled" if triangles were also cut out and holes filled; "rebuilt" if the
        complete surface was rebuilt on a grid.
    added_triangles, added_area_m2 : surface that does not lie on the given surface.
    removed_area_m2 : given surface that is not proven to be within `max_shape_m` of the result, because it
        was inside of the solid, or part of a self-intersection.
    bound_m : proven maximum distance of the other given surface from the result, and of the result, without
        added surface, from the given surface, metres.
    max_shape_m : applied distance limit, metres.
    volume_m3 : enclosed volume.
    thickness_min_m : minimum wall thickness behind a triangle, metres; None if no triangle has one.
    thickened_area_m2 : part of the added surface that makes walls thicker.
    thickened_max_m : maximum distance of its vertices from the surface without it.
    """

    closing: ClosingCounts
    intersections: str
    added_triangles: int
    added_area_m2: float
    removed_area_m2: float
    bound_m: float
    max_shape_m: float
    volume_m3: float
    thickness_min_m: float | None
    thickened_area_m2: float
    thickened_max_m: float

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return statistics for reports."""
        metrics = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "closing"}
        return {**asdict(self.closing), **metrics}


@dataclass(frozen=True, eq=False)
class SolidMesh:
    """A solid, with the sources of its vertices and triangles, or -1, and what was done."""

    mesh: Mesh
    vertex_source: Ids
    triangle_source: Ids
    result: SolidResult


def make_solid(
    given: Mesh,
    wall: float,
    max_shape: float | None,
    base_plane: BasePlane | None = None,
    min_thickness: float = 0.0,
) -> SolidMesh:
    """Make an oriented manifold solid.

    Parameters
    ----------
    given : oriented manifold, possibly with borders.
    wall : thickness of walls behind open sheets, metres; 0 to refuse sheets.
    max_shape : maximum distance by which self-intersecting surface may move, metres; None for half the median
        edge length.
    base_plane : plane on which the object stood; None to fit a plane to the borders.
    min_thickness : thickness to which thinner walls are thickened, metres; 0 to leave them.

    Raises
    ------
    MeshError
        If a component encloses no volume, and `wall` is 0, or nothing encloses a volume.
    UsageError
        If `manifold3d` is not installed.
    """
    require_manifold3d()
    edges = build_edges(given.triangles, len(given.vertices))
    lengths = np.linalg.norm(np.diff(given.vertices[edges.ends], axis=1)[:, 0], axis=1)
    edge_length = float(np.median(lengths))
    limit = _MAX_SHAPE_RATIO * edge_length if max_shape is None else max_shape
    closed, closing = close_borders(given, wall, edge_length, base_plane)
    # A grid must resolve walls.
    cell_size = 2 * limit if closing.thickened_sheets == 0 else min(2 * limit, wall / 2)
    shell, method = resolve_intersections(orient_components(closed), edge_length, cell_size)
    if base_plane is not None:
        # A rebuilt surface is not exact, and would reach below the plane.
        shell = trim_by_plane(shell, base_plane.normal, base_plane.offset_m)
    if not len(shell.triangles):
        raise MeshError(
            CLEAN_NOT_SOLID,
            "the closed surface winds around no volume",
            "mesh",
            remedy="check the orientation of the triangles, or set clean.max_shape to a smaller distance.",
        )
    lost = measure_lost_ratio(given, shell, edge_length)
    if lost > MAX_LOST_RATIO:
        emit(
            CLEAN_SOLID_INCOMPLETE.unmet(
                "{lost:.0%} of the surface is not part of the solid",
                remedy="set clean.wall to a larger thickness.",
                lost=lost,
            )
        )
    is_exact = shell.source >= 0
    restored_bound = 0.0
    if method in ("refilled", "rebuilt"):
        shell, restored_bound = _find_restored(shell, given, limit)
    is_thickened, thickened_max, nearest = np.zeros(len(shell.triangles), bool), 0.0, None
    if min_thickness > 0 and (thickened := thicken(shell, min_thickness, edge_length)) is not None:
        origin, thickened_max = thickened.shell.source, thickened.max_distance_m
        is_thickened = origin < 0
        is_exact = select_rows(is_exact, origin, False)
        nearest = select_rows(shell.source, thickened.nearest_triangle, -1)
        shell = replace(thickened.shell, source=select_rows(shell.source, origin, -1))
    _report_unsound(shell)
    bound, removed = _bound_distances(shell, is_exact, given, limit)
    transferred = transfer_attributes(shell, given, nearest)
    added = shell.source < 0
    areas = compute_areas(shell.vertices, shell.triangles)
    thickness = measure_thickness(shell.mesh)
    _report_thin(thickness, min_thickness)
    result = SolidResult(
        closing=closing,
        intersections=method,
        added_triangles=int(np.count_nonzero(added)),
        added_area_m2=float(areas[added].sum()),
        removed_area_m2=removed,
        bound_m=max(bound, restored_bound),
        max_shape_m=limit,
        volume_m3=float(compute_volumes(shell.vertices - shell.vertices.mean(axis=0), shell.triangles).sum()),
        thickness_min_m=float(np.nanmin(thickness)) if np.isfinite(thickness).any() else None,
        thickened_area_m2=float(areas[is_thickened].sum()),
        thickened_max_m=thickened_max,
    )
    return SolidMesh(transferred.mesh, transferred.vertex_source, shell.source, result)


def _report_thin(thickness: NDArray[np.float64], limit: float) -> None:
    count = int(np.count_nonzero(thickness < limit))
    if count:
        emit(
            CLEAN_SOLID_THIN.unmet(
                "the solid is thinner than {limit:.3g} m behind {count:,} triangles; the minimum is "
                "{minimum:.3g} m",
                remedy="set clean.wall to a larger thickness if the object is a sheet, or "
                "clean.min_thickness to another one.",
                count=count,
                limit=limit,
                minimum=float(np.nanmin(thickness)),
            )
        )


def _report_unsound(shell: Shell) -> None:
    unsound = find_unsound(shell)
    if unsound.any():
        x, y, z = shell.vertices[shell.triangles[np.flatnonzero(unsound)[0]]].mean(axis=0).tolist()
        emit(
            CLEAN_SOLID_INCOMPLETE.unmet(
                "the solid still intersects or touches itself at {count:,} triangles, the first at ({x:.6g}, "
                "{y:.6g}, {z:.6g}) m",
                remedy="set clean.max_shape to another distance.",
                count=int(unsound.sum()),
                x=x,
                y=y,
                z=z,
            )
        )


def _find_restored(shell: Shell, given: Mesh, limit: float) -> tuple[Shell, float]:
    """Find the given triangle that each rebuilt triangle replaces.

    Such a triangle is proven to be within the limit of the given surface, and has its direction. The largest
    of these proven distances is returned, too.
    """
    (added,) = np.nonzero(shell.source < 0)
    corners = shell.vertices[shell.triangles[added]]
    surface = RaycastingSurface(given)
    centers = surface.find_closest_points(corners.mean(axis=1))
    vectors = compute_area_vectors(corners)
    lengths = np.linalg.norm(vectors, axis=1)
    cosine = np.einsum("ij,ij->i", vectors, surface.normals[centers.triangles])
    restored = (centers.distances <= limit) & (cosine >= _MIN_RESTORED_COSINE * lengths)
    for corner in range(3):
        restored &= surface.find_closest_points(corners[:, corner]).distances <= limit
    source = shell.source.copy()
    source[added[restored]] = centers.triangles[restored]
    if not restored.any():
        return shell, 0.0
    is_restored = np.isin(np.arange(len(source)), added[restored])
    bounds = _bound_one_sided(shell.select(is_restored).mesh, given, limit)
    source[np.flatnonzero(is_restored)[bounds > limit]] = -1
    return Shell(shell.vertices, shell.triangles, source), float(bounds[bounds <= limit].max(initial=0.0))


def _bound_distances(
    shell: Shell, is_exact: NDArray[np.bool_], given: Mesh, limit: float
) -> tuple[float, float]:
    """Bound the distance of the given surface from the result.

    Returns
    -------
    bound : metres, proven for all points that are not part of `removed`.
    removed : area in m² of given triangles whose distance is not proven to be within the limit.
    """
    given_areas = compute_areas(given.vertices, given.triangles)
    present = np.bincount(
        shell.source[is_exact],
        compute_areas(shell.vertices, shell.triangles[is_exact]),
        len(given.triangles),
    )
    changed = present < (1 - _AREA_TOLERANCE) * given_areas
    bound = 0.0
    removed = 0.0
    if changed.any():
        own = Shell(given.vertices, given.triangles, np.arange(len(given.triangles))).select(changed)
        bounds = _bound_one_sided(own.mesh, shell.mesh, limit)
        is_removed = bounds > limit
        removed = float(given_areas[changed][is_removed].sum())
        bound = max(bound, float(bounds[~is_removed].max(initial=0.0)))
    return bound, removed


def _bound_one_sided(part: Mesh, whole: Mesh, limit: float) -> NDArray[np.float64]:
    """Bound the distance (m,) from each triangle of a part to a surface, metres.

    Only triangles near the part are searched: the distance to some of the surface bounds that to all of it.
    """
    _, distances = RaycastingSurface(part).find_nearest_triangles(whole.vertices)
    near = (distances <= 4 * limit)[whole.triangles].any(axis=1)
    corners = whole.vertices[whole.triangles]
    size = np.linalg.norm(np.ptp(corners, axis=1), axis=1)
    # A large triangle can pass near the part although its corners are far.
    near |= distances[whole.triangles].min(axis=1) <= 4 * limit + size
    used, index = np.unique(whole.triangles[near], return_inverse=True)
    close = Mesh(whole.vertices[used], index.reshape(-1, 3).astype(np.int32))
    return certify(close, part, max_shape=limit).original_shape_bound
