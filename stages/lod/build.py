"""Construction of a level-of-detail hierarchy from a mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.lod.codes import LEVELS_BOUND_NOT_PROVEN, LEVELS_ISLANDS_DROPPED, LEVELS_LEFT_OUT
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.source_mesh import encode_glb
from scanloom.stages.params import check_parameters as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.certified.constants import (
    EXPECTED_REDUCTION,
    MAX_SUBDIVISIONS,
    VERTEX_BOUND_RATIO,
)
from scanloom.stages.simplification.color_weight import compute_balanced_weight
from scanloom.stages.simplification.manifold_sheets import (
    build_sheet_mesh,
    find_split_vertices,
    report_split_vertices,
    split_into_sheets,
    weld_into_sheets,
)
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.small_components import find_small_components
from scanloom.stages.surface.surface_color import compute_surface_colors, get_vertex_attributes, is_textured
from scanloom.stages.surface.topology import require_area, require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import LodKeywords

# Increment when the levels of the same mesh change, to invalidate cache entries.
RESULT_VERSION = 6

# Relative tolerance of proven bounds over measured errors: tighter bounds take longer than building levels.
_SHAPE_TOLERANCE, _COLOR_TOLERANCE = 0.15, 0.2
# Maximum distance between two colours, levels.
_MAX_COLOR_DISTANCE = 255 * math.sqrt(3)
# Bound of the first level relative to the base error, if there is a base error.
_FIRST_PER_BASE = 2.5
# Bound of the first level relative to the median vertex height, if there is no base error.
_FIRST_PER_HEIGHT = 1.4
# Minimum bound of the first level relative to the bounding box diagonal: flat meshes need levels, too.
_MIN_FIRST_PER_DIAGONAL = 1e-5


@dataclass(frozen=True, kw_only=True)
class LevelsParams:
    """Parameters of the levels above the finest."""

    first_error: float | None = param(
        None,
        "Error bound of the first level above the finest. Default: estimated from the mesh, so that the "
        "level has a third to a half of the triangles.",
        unit="m",
        low=0,
        low_open=True,
    )
    ratio: float = param(2.5, "Ratio between the error bounds of consecutive levels.", low=1.1, high=10)
    cell_triangles: int = param(
        10_000, "Maximum triangles of a cell, which is loaded, refined and drawn as a unit.", low=64
    )
    root_triangles: int = param(1_000, "Stop when a level has no more triangles than this.", low=4)
    drop_islands: float = param(
        0.0,
        "Drop small connected components first: those with a smaller bounding box diagonal. Error bounds are "
        "then one-sided, because dropped components are near no level. 0 keeps all.",
        unit="m",
        low=0,
    )
    threads: int | None = param(
        None,
        "Number of threads, with the same result. Default: all processors.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check_params(self)


@dataclass(frozen=True, kw_only=True)
class LodParams(LevelsParams):
    """Parameters of level-of-detail hierarchies."""

    base_error: float = param(
        0.0,
        "Proven error bound of the finest level, a simplified mesh; 0 uses the mesh itself.",
        unit="m",
        low=0,
    )


def build(
    mesh: MeshLike,
    params: LodParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[LodKeywords],
) -> Hierarchy:
    """Build the levels of detail of a mesh.

    The surface is divided into cells along edges of the mesh. Each level is simplified within a larger bound,
    with locked cell borders. Then neighbouring cells are merged, until one is left.

    The bound of each cell is proven on each level against the cell's part of the input mesh, in shape and
    colour, at every point and in both directions. Bounds of levels do not accumulate. If `base_error` is set,
    the reference is the mesh simplified within it, and its bound is added. With `drop_islands`, the reference
    is the mesh without the dropped components.

    The method follows Wang, Lu and Pan, "Dynamic evaluation and modification for progressive mesh
    hierarchies" (2012), with clusters of Garland, Willmott and Heckbert (2001) and fitted instead of
    half-edge collapses.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres. Levels of a textured
        mesh get vertex colours. The textured mesh itself is kept as `Hierarchy.model`, to texture tiles and
        cuts.
    params : LodParams; single parameters can be given by keyword instead.
    progress : called with the number of removed triangles and their total.

    Returns
    -------
    Hierarchy

    Raises
    ------
    InputError
        If the mesh has no triangles, or all its components would be dropped.
    MeshError
        If the mesh is invalid, or its coordinates are too large.
    UsageError
        If a parameter is out of range.
    """
    with collecting() as diagnostics:
        hierarchy = _build_hierarchy(as_mesh(mesh), resolve(LodParams, params, changes), progress)
    return replace(hierarchy, diagnostics=tuple(diagnostics))


def _build_hierarchy(mesh: Mesh, params: LodParams, progress: Progress) -> Hierarchy:
    require_measurable(mesh, "mesh")
    if len(mesh.triangles) == 0:
        raise InputError(MESH_NO_SURFACE, "the mesh has no triangles; no levels can be built.")
    require_area(mesh, "mesh")
    kept, islands = _drop_small_components(mesh, params.drop_islands)
    base, shape, color, progress = _build_base(_strip_attributes(kept), params, progress)
    hierarchy = _build_from_any(base, params, shape, progress)
    if shape:
        hierarchy = widen_bounds(hierarchy, shape, color)
    return replace(
        hierarchy,
        input_triangles=len(mesh.triangles),
        dropped_islands=islands,
        dropped_triangles=len(mesh.triangles) - len(kept.triangles),
        up=mesh.up,
        model_glb=encode_glb(kept) if is_textured(kept) else None,
    )


def widen_bounds(hierarchy: Hierarchy, shape: float, color: float) -> Hierarchy:
    """Widen all bounds of a hierarchy by the deviation of its base mesh.

    Parameters
    ----------
    hierarchy : levels built from a simplified mesh.
    shape, color : proven two-sided deviation of that mesh from the original, metres and levels. The sum is
        valid by the triangle inequality.
    """
    return replace(
        hierarchy,
        shape_bound=hierarchy.shape_bound + shape,
        color_bound=np.minimum(hierarchy.color_bound + color, _MAX_COLOR_DISTANCE),
        base_shape_bound=hierarchy.base_shape_bound + shape,
        base_color_bound=hierarchy.base_color_bound + color,
    )


def _strip_attributes(mesh: Mesh) -> Mesh:
    """Return a mesh with vertex colours only, and warn about dropped attributes."""
    dropped = {"parts": mesh.part_ids, "corner normals": mesh.corner_normals, "normals": mesh.normals}
    names = [name for name, value in dropped.items() if value is not None]
    if names:
        emit(
            LEVELS_LEFT_OUT.warning(
                "lod drops these attributes of the mesh: {names}.", names=", ".join(names)
            )
        )
    if is_textured(mesh):
        mesh = mesh.with_(colors=_average_vertex_colors(mesh))
    return Mesh(mesh.vertices, mesh.triangles, colors=mesh.colors, up=mesh.up)


def _drop_small_components(mesh: Mesh, size: float) -> tuple[Mesh, int]:
    """Remove connected components smaller than `size`, metres.

    Returns
    -------
    The mesh, and the number of removed components.
    """
    if size == 0:
        return mesh, 0
    small, islands = find_small_components(mesh, size)
    if small.all():
        raise InputError(
            LEVELS_ISLANDS_DROPPED,
            "all connected components of the mesh are smaller than {size:g} m; nothing would be left.",
            size=size,
        )
    if not islands:
        return mesh, 0
    emit(
        LEVELS_ISLANDS_DROPPED.warning(
            "{islands:,} connected components smaller than {size:g} m, with {triangles:,} triangles, were "
            "dropped; error bounds do not cover them.",
            islands=islands,
            size=size,
            triangles=np.count_nonzero(small),
        )
    )
    source = np.flatnonzero(~small)
    return mesh.with_triangles(mesh.triangles[source], source), islands


def _average_vertex_colors(mesh: Mesh) -> NDArray[np.uint8]:
    """Average the corner colours of each vertex, (n, 3); black for unused vertices."""
    corner = mesh.triangles.reshape(-1)
    weights = np.tile(np.eye(3), (len(mesh.triangles), 1))
    found = compute_surface_colors(mesh, np.repeat(np.arange(len(mesh.triangles)), 3), weights)
    count = np.maximum(np.bincount(corner, minlength=len(mesh.vertices)), 1)
    sums = [np.bincount(corner, channel, minlength=len(mesh.vertices)) for channel in found.T]
    return np.rint(np.stack(sums, axis=1) / count[:, None]).clip(0, 255).astype(np.uint8)


def _build_base(mesh: Mesh, params: LodParams, progress: Progress) -> tuple[Mesh, float, float, Progress]:
    """Build the finest level.

    Returns
    -------
    The mesh, its proven bounds in metres and colour levels, and the progress callback for the remaining work.
    """
    if params.base_error == 0:
        return mesh, 0.0, 0.0, progress
    count = len(mesh.triangles)
    half_count = count // 2
    with collecting(forward=False):
        simplified = simplify(
            mesh,
            method="certified",
            max_shape=params.base_error,
            certified={"tight_bounds": mesh.colors is not None},
            threads=params.threads,
            progress=_map_progress(progress, 0, half_count, count),
        )
    # The proven bounds are used as they are, so an unmet request is no problem here.
    emit(*(one for one in simplified.diagnostics if one.severity != Severity.UNMET))
    details = simplified.details
    bounds = float(details.shape_bound_m), float(details.color_bound_levels or 0.0)
    return simplified.mesh, *bounds, _map_progress(progress, half_count, count, count)


def _map_progress(progress: Progress, first: int, last: int, count: int) -> Progress:
    """Return a callback that maps the progress of a step to `first`…`last` of `count`."""

    def report(done: int, total: int) -> object:
        return progress(first + (last - first) * done // max(total, 1), count)

    return report


def _build_from_any(mesh: Mesh, params: LodParams, base_error: float, progress: Progress) -> Hierarchy:
    """Build the hierarchy of a mesh that may be non-manifold or have duplicated vertices."""
    sheets = weld_into_sheets(mesh)
    if sheets is None:
        try:
            return _build_from_manifold(mesh, np.zeros(0, bool), params, base_error, progress)
        except _kernels.InvalidMeshError:
            # Non-manifold: cut the mesh into manifold sheets.
            sheets = split_into_sheets(mesh)
    manifold = build_sheet_mesh(mesh, sheets)
    is_split_vertex = find_split_vertices(mesh, sheets)
    report_split_vertices(is_split_vertex)
    return _build_from_manifold(manifold, is_split_vertex, params, base_error, progress)


def _build_from_manifold(
    mesh: Mesh, locked: NDArray[np.bool_], params: LodParams, base_error: float, progress: Progress
) -> Hierarchy:
    weight = 0.0
    if mesh.colors is not None:
        weight = compute_balanced_weight(
            mesh, max(len(mesh.triangles) // EXPECTED_REDUCTION, 1), params.threads or 0
        )
    first = params.first_error or (
        _FIRST_PER_BASE * base_error if base_error else _estimate_first_error(mesh)
    )
    levels = _kernels.build_levels(
        mesh.vertices,
        get_vertex_attributes(mesh),
        mesh.triangles,
        locked,
        first=first,
        ratio=params.ratio,
        max_cell_triangles=params.cell_triangles,
        root_triangles=params.root_triangles,
        weight=weight,
        share=VERTEX_BOUND_RATIO,
        tolerance=(_SHAPE_TOLERANCE, _COLOR_TOLERANCE),
        effort=MAX_SUBDIVISIONS,
        single=bool((mesh.vertices == mesh.vertices.astype(np.float32)).all()),
        running=_kernels.RunSettings(threads=params.threads or 0),
        progress=progress,
    )
    if levels.unproven:
        emit(
            LEVELS_BOUND_NOT_PROVEN.warning(
                "{count:,} triangles are not proven to be within the bound of their level; their nodes state "
                "the larger bound that is proven.",
                count=levels.unproven,
            )
        )
    return Hierarchy(
        vertices=levels.vertices,
        colors=None if mesh.colors is None else levels.attributes.astype(np.uint8),
        roots=levels.root_vertex_count,
        origin=levels.origin.astype(np.uint32),
        made=levels.new_vertex_counts,
        born=levels.new_triangle_counts,
        triangles=levels.triangles.astype(np.uint32),
        parent=levels.parent,
        level=levels.level,
        coarse=levels.coarse_triangle_counts,
        first_split=levels.first_split,
        first_triangle=levels.first_triangle,
        shape_bound=levels.shape_bound,
        color_bound=levels.color_bound,
        base_shape_bound=0.0,
        base_color_bound=0.0,
        input_triangles=len(mesh.triangles),
    )


def _estimate_first_error(mesh: Mesh) -> float:
    """Estimate the error bound of the first level from vertex heights, metres.

    The height is the distance of a vertex from the mean of its neighbours, along the vertex normal. Half of
    the vertices are below the median height, and about as many can be removed within the bound.
    """
    corners, triangles = mesh.vertices[mesh.triangles], mesh.triangles
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    count = len(mesh.vertices)
    corner = triangles.T.reshape(-1)
    others = [corners[:, (i + 1) % 3] + corners[:, (i + 2) % 3] for i in range(3)]
    normal = _sum_rows(corner, np.tile(normals, (3, 1)), count)
    mean = _sum_rows(corner, np.concatenate(others), count)
    valence = 2.0 * np.bincount(corner, minlength=count)
    length = np.linalg.norm(normal, axis=1)
    is_defined = (length > 0) & (valence > 0)
    offset = mesh.vertices[is_defined] - mean[is_defined] / valence[is_defined, None]
    height = np.abs(np.einsum("ij,ij->i", offset, normal[is_defined])) / length[is_defined]
    estimate = _FIRST_PER_HEIGHT * float(np.median(height)) if is_defined.any() else 0.0
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return max(estimate, _MIN_FIRST_PER_DIAGONAL * diagonal, float(np.finfo(np.float64).tiny))


def _sum_rows(at: NDArray[np.int32], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Sum the rows (k, 3) with the same index `at`, (count, 3)."""
    return np.stack([np.bincount(at, column, minlength=count) for column in values.T], axis=1)
