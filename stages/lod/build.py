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
from scanloom.stages.lod.model import packed
from scanloom.stages.params import check as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.progress import Progress, silent
from scanloom.stages.simplification.certified.effort import PIECES, REDUCTION, SHARE_OF_VERTICES
from scanloom.stages.simplification.color_weight import balanced_weight
from scanloom.stages.simplification.in_sheets import in_sheets, is_split, joined, report_split, sheets_of
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.codes import MESH_NO_SURFACE
from scanloom.stages.surface.color import attributes_of, color_at, is_textured
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.small_components import find_small_components
from scanloom.stages.surface.topology import require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import LodKeywords

# Increment when the levels of the same mesh change, to invalidate cache entries.
RESULT_VERSION = 5

# Relative tolerance of proven bounds over measured errors: tighter bounds take longer than building levels.
_TOLERANCE_OF_SHAPE, _TOLERANCE_OF_COLOR = 0.15, 0.2
# Maximum distance between two colours, levels.
_FARTHEST_COLOR = 255 * math.sqrt(3)
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
        common=True,
    )


def build(
    mesh: MeshLike,
    params: LodParams | None = None,
    *,
    progress: Progress = silent,
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
        hierarchy = _built(as_mesh(mesh), resolve(LodParams, params, changes), progress)
    return replace(hierarchy, diagnostics=tuple(diagnostics))


def _built(given: Mesh, params: LodParams, progress: Progress) -> Hierarchy:
    require_measurable(given, "mesh")
    if len(given.triangles) == 0:
        raise InputError(MESH_NO_SURFACE, "the mesh has no triangles; no levels can be built.")
    kept, islands = _without_islands(given, params.drop_islands)
    base, shape, color, progress = _base(_plain(kept), params, progress)
    hierarchy = _of_any(base, params, shape, progress)
    if shape:
        hierarchy = further_off(hierarchy, shape, color)
    return replace(
        hierarchy,
        input_triangles=len(given.triangles),
        dropped_islands=islands,
        dropped_triangles=len(given.triangles) - len(kept.triangles),
        up=given.up,
        model_glb=packed(kept) if is_textured(kept) else None,
    )


def further_off(hierarchy: Hierarchy, shape: float, color: float) -> Hierarchy:
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
        color_bound=np.minimum(hierarchy.color_bound + color, _FARTHEST_COLOR),
        base_shape_bound=hierarchy.base_shape_bound + shape,
        base_color_bound=hierarchy.base_color_bound + color,
    )


def _plain(mesh: Mesh) -> Mesh:
    """Return a mesh with vertex colours only, and warn about dropped attributes."""
    lost = {"parts": mesh.part_ids, "corner normals": mesh.corner_normals, "normals": mesh.normals}
    names = [name for name, value in lost.items() if value is not None]
    if names:
        emit(
            LEVELS_LEFT_OUT.warning(
                "lod drops these attributes of the mesh: {names}.", names=", ".join(names)
            )
        )
    if is_textured(mesh):
        mesh = mesh.with_(colors=_colors_of_vertices(mesh))
    return Mesh(mesh.vertices, mesh.triangles, colors=mesh.colors, up=mesh.up)


def _without_islands(mesh: Mesh, size: float) -> tuple[Mesh, int]:
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


def _colors_of_vertices(mesh: Mesh) -> NDArray[np.uint8]:
    """Average the corner colours of each vertex, (n, 3); black for unused vertices."""
    corner = mesh.triangles.reshape(-1)
    weights = np.tile(np.eye(3), (len(mesh.triangles), 1))
    found = color_at(mesh, np.repeat(np.arange(len(mesh.triangles)), 3), weights)
    count = np.maximum(np.bincount(corner, minlength=len(mesh.vertices)), 1)
    sums = [np.bincount(corner, channel, minlength=len(mesh.vertices)) for channel in found.T]
    return np.rint(np.stack(sums, axis=1) / count[:, None]).clip(0, 255).astype(np.uint8)


def _base(mesh: Mesh, params: LodParams, progress: Progress) -> tuple[Mesh, float, float, Progress]:
    """Build the finest level.

    Returns
    -------
    The mesh, its proven bounds in metres and colour levels, and the progress callback for the remaining work.
    """
    if params.base_error == 0:
        return mesh, 0.0, 0.0, progress
    count = len(mesh.triangles)
    half = count // 2
    with collecting(forward=False):
        light = simplify(
            mesh,
            method="certified",
            max_shape=params.base_error,
            certified={"close_bounds": mesh.colors is not None},
            threads=params.threads,
            progress=_part(progress, 0, half, count),
        )
    # The proven bounds are used as they are, so an unmet request is no problem here.
    emit(*(one for one in light.diagnostics if one.severity != Severity.UNMET))
    details = light.details
    bounds = float(details.shape_bound_m), float(details.color_bound_levels or 0.0)
    return light.mesh, *bounds, _part(progress, half, count, count)


def _part(progress: Progress, first: int, last: int, count: int) -> Progress:
    """Return a callback that maps the progress of a step to `first`…`last` of `count`."""

    def tell(done: int, total: int) -> object:
        return progress(first + (last - first) * done // max(total, 1), count)

    return tell


def _of_any(mesh: Mesh, params: LodParams, base_error: float, progress: Progress) -> Hierarchy:
    """Build the hierarchy of a mesh that may be non-manifold or have duplicated vertices."""
    sheets = joined(mesh)
    if sheets is None:
        try:
            return _of_manifold(mesh, np.zeros(0, bool), params, base_error, progress)
        except _kernels.InvalidMeshError:
            # Non-manifold: cut the mesh into manifold sheets.
            sheets = sheets_of(mesh)
    whole = in_sheets(mesh, sheets)
    split = is_split(mesh, sheets)
    report_split(split)
    return _of_manifold(whole, split, params, base_error, progress)


def _of_manifold(
    mesh: Mesh, locked: NDArray[np.bool_], params: LodParams, base_error: float, progress: Progress
) -> Hierarchy:
    weight = 0.0
    if mesh.colors is not None:
        weight = balanced_weight(mesh, max(len(mesh.triangles) // REDUCTION, 1), params.threads or 0)
    first = params.first_error or (
        _FIRST_PER_BASE * base_error if base_error else _estimate_first_error(mesh)
    )
    levels = _kernels.build_levels(
        mesh.vertices,
        attributes_of(mesh),
        mesh.triangles,
        locked,
        first=first,
        ratio=params.ratio,
        most=params.cell_triangles,
        root=params.root_triangles,
        weight=weight,
        share=SHARE_OF_VERTICES,
        tolerance=(_TOLERANCE_OF_SHAPE, _TOLERANCE_OF_COLOR),
        effort=PIECES,
        single=bool((mesh.vertices == mesh.vertices.astype(np.float32)).all()),
        running=_kernels.Running(threads=params.threads or 0),
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
        roots=levels.roots,
        origin=levels.origin.astype(np.uint32),
        made=levels.made,
        born=levels.born,
        triangles=levels.triangles.astype(np.uint32),
        parent=levels.parent,
        level=levels.level,
        coarse=levels.coarse,
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
    told = (length > 0) & (valence > 0)
    offset = mesh.vertices[told] - mean[told] / valence[told, None]
    height = np.abs(np.einsum("ij,ij->i", offset, normal[told])) / length[told]
    found = _FIRST_PER_HEIGHT * float(np.median(height)) if told.any() else 0.0
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0)))
    return max(found, _MIN_FIRST_PER_DIAGONAL * diagonal, float(np.finfo(np.float64).tiny))


def _sum_rows(at: NDArray[np.int32], values: NDArray[np.float64], count: int) -> NDArray[np.float64]:
    """Sum the rows (k, 3) with the same index `at`, (count, 3)."""
    return np.stack([np.bincount(at, column, minlength=count) for column in values.T], axis=1)
