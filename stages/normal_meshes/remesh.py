"""Remeshing of manifold meshes to normal meshes.

A normal mesh has regular triangles at several levels of detail.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Severity
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.lod.codes import LEVELS_LEFT_OUT
from scanloom.stages.normal_meshes.codes import (
    LEVELS_BASE_LARGE,
    LEVELS_FOLDED,
    LEVELS_NORMAL_MESH_INEXACT,
    LEVELS_TOO_FINE,
    LEVELS_VERTICES_SPLIT,
)
from scanloom.stages.normal_meshes.normal_mesh import NormalMesh, convert_kernel_mesh
from scanloom.stages.normal_meshes.tangential_laplacian import relax_tangentially
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.kernel_input import create_texture_warning
from scanloom.stages.simplification.manifold_sheets import (
    build_sheet_mesh,
    find_split_vertices,
    split_into_sheets,
    weld_into_sheets,
)
from scanloom.stages.simplification.simplify import simplify
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.sheet_decomposition import Sheets
from scanloom.stages.surface.surface_color import get_vertex_attributes
from scanloom.stages.surface.topology import require_area
from scanloom.stages.surface.tracked_mesh import TrackedMesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import RemeshKeywords

RESULT_VERSION = 7

# Ratio of actual to requested base triangles above which a warning is emitted: all levels grow by that
# factor.
_MAX_BASE_RATIO = 1.5

# Levels that the default base size is derived from if `levels` is not given.
_DEFAULT_LEVELS = 4

# Precision of 32-bit floats, as a ratio of the bounding-box diagonal.
_FLOAT32_PRECISION = 5e-8
# Minimum length of most edges in steps of the largest coordinate. With 1,000 steps, rounding folds the mesh,
# and remeshing a hundred triangles takes minutes.
_MIN_STEPS_PER_EDGE = 4096

# Texts for the kernel's identifiers of the tolerance's origin.
_TOLERANCE_SOURCES = {
    "given": "given",
    "distance": "from the distance between the finest level and the mesh",
    "noise": "from the noise of the mesh",
    "bound": "from max_error",
    "precision": "from the precision of 32-bit floats, because the finest level is practically exact",
}

_LEVELS_GROUP = "Base mesh and levels"
_METHOD_GROUP = "Method"
_PRECISION_GROUP = "Precision of the file"


@dataclass(frozen=True, kw_only=True)
class RemeshParams:
    """Parameters of remeshing: levels, base mesh and rounding."""

    levels: int | None = param(
        None,
        "Refinements of the base mesh; each splits a triangle into four. Default: 1 to 4, so that the finest "
        "level has about as many triangles as the input; with max_error at most 4.",
        group=_LEVELS_GROUP,
        low=0,
        high=10,
        common=True,
    )
    base_triangles: int | None = param(
        None,
        "Target triangle count of the base mesh; more remain only where fewer could not be refined. With "
        "levels 0, and without base_error and max_error, the base is the simplified mesh, whose vertices are "
        "moved to minimise the distance to the input. Default, unless base_error is given: the finest level "
        "gets about as many triangles as the input, or more where fewer would be inaccurate.",
        group=_LEVELS_GROUP,
        low=1,
        common=True,
    )
    base_error: float | None = param(
        None,
        "Maximum distance from the input that a collapse may add while the base mesh is made. With "
        "base_triangles, collapsing stops at whichever limit comes first.",
        group=_LEVELS_GROUP,
        unit="m",
        low=0,
        low_open=True,
    )
    max_error: float | None = param(
        None,
        "Stop at the first level whose measured maximum distance from the input, in both directions, is at "
        "most this. If no level reaches it, all levels are written.",
        group=_LEVELS_GROUP,
        unit="m",
        low=0,
        low_open=True,
    )
    scheme: str = param(
        "linear",
        "Prediction of new vertices: at the middle of their edge (`linear`), or by the modified butterfly "
        "scheme, which gives smaller offsets on smooth shapes.",
        group=_METHOD_GROUP,
        choices=("linear", "butterfly"),
    )
    relaxations: int = param(
        1,
        "Tangential smoothing steps of new vertices before their offsets are computed, for more regular "
        "triangles.",
        group=_METHOD_GROUP,
        low=0,
        high=100,
    )
    tangential_steps: int = param(
        0,
        "Steps of the paper's tangential Laplacian on all interior vertices of the finest level, after their "
        "offsets. Triangles become more regular, and vertices leave the input surface. The .snm file holds "
        "the level without these steps.",
        group=_METHOD_GROUP,
        low=0,
        high=100,
    )
    threads: int | None = param(
        None,
        "CPU threads; the result is the same for any number. Default: all.",
        group=_METHOD_GROUP,
        low=1,
        high=256,
        invalidates=False,
    )
    tolerance: float | None = param(
        None,
        "Maximum distance by which rounding moves a vertex off the input surface, as a ratio of the bounding "
        "box's diagonal. If the base is the simplified mesh, its distance from the input is not included. "
        "Default: a third of the RMS distance of the finest level from the input; half of it where noise of "
        "the mesh hides that distance; three times it for the simplified mesh, whose actual rounding is far "
        "smaller. It is at most a sixteenth of max_error, and at least the precision of 32-bit floats, 5e-8.",
        group=_PRECISION_GROUP,
        low=1e-9,
        high=0.01,
    )
    color_tolerance: float = param(
        2.0,
        "Maximum rounding error of a channel of a vertex colour.",
        group=_PRECISION_GROUP,
        unit="8-bit levels",
        low=0,
        high=64,
    )

    def __post_init__(self) -> None:
        check_parameters(self)

    def derive_base_triangles(self, triangle_count: int) -> int:
        """Return the target triangle count of the base mesh.

        Parameters
        ----------
        triangle_count : triangle count of the input.

        Returns
        -------
        int
            0 if `base_error` alone limits the base mesh.
        """
        if self.base_triangles is not None:
            return self.base_triangles
        levels = _DEFAULT_LEVELS if self.levels is None else self.levels
        return 0 if self.base_error is not None else max(round(triangle_count / 4**levels), 1)


def remesh(
    mesh: MeshLike,
    params: RemeshParams | None = None,
    *,
    confidence: ArrayLike | None = None,
    progress: Progress = ignore_progress,
    **changes: Unpack[RemeshKeywords],
) -> NormalMesh:
    """Remesh a surface to a normal mesh.

    The result is a base mesh with refinements that lie on the surface.

    Half-edge collapses simplify the input to the base mesh. With `levels=0` the base mesh is the result of
    `simplify` instead. Each refinement splits every edge, predicts the new vertex, and moves it along the
    predicted normal to the surface: one scalar per vertex. Boundary vertices store a vector. So do vertices
    whose normal does not hit the surface. Values are rounded before the next level is computed, so `decode`
    reproduces the levels from `data` bit for bit.

    Every level has the genus, connected components, boundary loops and orientation of the input. The same
    input gives the same bytes, for any number of threads.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres. Vertices at equal
        positions are welded. If the welded mesh is not an oriented manifold, it is cut into manifold sheets
        and a warning is emitted. Unreferenced vertices and triangles that repeat a vertex are dropped.
    params : RemeshParams; single fields can be given by name instead.
    confidence : (n,) finite numbers per vertex, interpolated like colours and stored with 8 bits between
        their
        minimum and maximum.
    progress : called about ten times per second with the number of finished levels and the maximum number of
        levels, both including levels of candidate base meshes. An exception raised by it aborts the work.

    Returns
    -------
    NormalMesh
        With colours if the input has colours. Texture and normals are dropped with a warning. Source indices
        refer to the input before welding and cutting.

    Raises
    ------
    MeshError
        If an edge has more than two triangles or inconsistent orientation (`clean` repairs both; the message
        names the edges), if the mesh has no surface, or if `confidence` is not one finite number per vertex.
    UsageError
        If a parameter is out of range.

    References
    ----------
    Li, Li, Xu and Li, "Normal mesh generation based on Laplacian operator", 2002; Guskov, Vidimče, Sweldens
    and Schröder, "Normal meshes", 2000; for scheme "butterfly" Zorin, Schröder and Sweldens, "Interpolating
    subdivision for meshes with arbitrary topology", 1996.
    """
    with collecting() as diagnostics:
        params = resolve(RemeshParams, params, changes)
        result = _remesh_validated(as_mesh(mesh), params, confidence, progress)
    if params.tangential_steps:
        result = replace(result, relaxed=relax_tangentially(result.levels[-1], params.tangential_steps))
    return replace(result, diagnostics=tuple(diagnostics))


def _remesh_validated(
    mesh: Mesh, params: RemeshParams, confidence: ArrayLike | None, progress: Progress
) -> NormalMesh:
    values = _validate_confidence(confidence, len(mesh.vertices))
    require_area(mesh, "mesh")
    wanted = params.derive_base_triangles(len(mesh.triangles))
    _require_resolution(mesh, params)
    bare = mesh.with_(texture=None, normals=None, corner_normals=None, part_ids=None)
    start, original = _make_start_mesh(bare, params, progress)
    sheets = weld_into_sheets(start.mesh)
    traced = _cut_sheets(start, sheets)
    try:
        found = _run_kernel(traced, original, values, params, wanted, progress)
    except _kernels.InvalidMeshError:
        # Non-manifold meshes are rare, so the cost of cutting sheets is paid only after the kernel refuses
        # the mesh.
        sheets = split_into_sheets(start.mesh)
        traced = _cut_sheets(start, sheets)
        found = _run_kernel(traced, original, values, params, wanted, progress)
    split = (
        0 if sheets is None else len(np.unique(sheets.vertex_source[find_split_vertices(start.mesh, sheets)]))
    )
    if original is None:
        hits = [traced.triangle_source[found.hit_triangle(level)] for level in range(found.levels + 1)]
    else:
        hits = [_find_nearest_triangles(original, found.vertices(0))]
    _report_left_out(mesh)
    _report_result(found, params, wanted, split)
    return convert_kernel_mesh(
        found,
        mesh.diagnostics,
        base_source=traced.vertex_source[found.base_source].astype(np.int32),
        triangle_source=tuple(triangles.astype(np.int32) for triangles in hits),
        max_distances_m=tuple(found.reached),
        folded_by_level=tuple(found.folded_counts),
        **_describe_tolerance(found, traced.mesh),
    )


def _require_resolution(mesh: Mesh, params: RemeshParams) -> None:
    """Refuse a mesh whose edges are below the precision of numbers.

    The limit is float32 precision relative to its extent, which a single stray vertex enlarges, and a
    multiple of float64 precision relative to its coordinates.
    """
    corners = mesh.vertices[mesh.triangles]
    finest = min(params.tolerance or _FLOAT32_PRECISION, _FLOAT32_PRECISION) * _compute_diagonal(mesh)
    lengths = np.linalg.norm(corners - corners[:, [1, 2, 0]], axis=2)
    if np.median(lengths) < finest:
        away = np.linalg.norm(mesh.vertices - np.median(corners.reshape(-1, 3), axis=0), axis=1)
        used = np.unique(mesh.triangles)
        farthest = used[np.argmax(away[used])]
        raise MeshError(
            LEVELS_TOO_FINE,
            (
                "most edges are shorter than {finest:.2g} m, the precision of the format for "
                "a mesh of this size"
            ),
            "mesh",
            remedy="remove vertices far from the rest: vertex {farthest} is {away:.2g} m away.",
            finest=finest,
            farthest=farthest,
            away=away[farthest],
        )
    largest = float(np.abs(corners).max())
    coarsest = _MIN_STEPS_PER_EDGE * float(np.spacing(largest))
    if np.median(lengths) < coarsest:
        raise MeshError(
            LEVELS_TOO_FINE,
            "most edges are shorter than {coarsest:.2g} m, the precision of coordinates of {largest:.2g} m",
            "mesh",
            remedy="move the mesh to the origin.",
            coarsest=coarsest,
            largest=largest,
        )


def _compute_diagonal(mesh: Mesh) -> float:
    """Return the bounding-box diagonal of all vertices used by triangles, in metres."""
    return float(np.linalg.norm(np.ptp(mesh.vertices[np.unique(mesh.triangles)], axis=0)))


def _make_start_mesh(mesh: Mesh, params: RemeshParams, progress: Progress) -> tuple[TrackedMesh, Mesh | None]:
    """Return the mesh to remesh, and the input mesh if different.

    Without refinements, the base mesh need not consist of input vertices. The result of `simplify` is used
    then, because it approximates the input better.
    """
    wanted = params.base_triangles
    bounds = (params.base_error, params.max_error)
    if params.levels != 0 or wanted is None or wanted >= len(mesh.triangles) or any(bounds):
        return TrackedMesh.start(mesh), None

    def report_start(done: int, total: int) -> object:  # noqa: ARG001
        return progress(0, 1)

    with collecting(forward=False):
        simplified = simplify(
            mesh,
            method="quadric",
            triangles=wanted,
            threads=params.threads,
            bake=False,
            progress=report_start,
        )
    # The base triangle count is a target, not a requirement.
    emit(*(one for one in simplified.diagnostics if one.severity != Severity.UNMET))
    sources = simplified.vertex_source.astype(np.int64), simplified.triangle_source.astype(np.int64)
    return TrackedMesh(simplified.mesh, *sources), mesh


def _run_kernel(
    traced: TrackedMesh,
    original: Mesh | None,
    confidence: NDArray[np.float64],
    params: RemeshParams,
    target_base_triangles: int,
    progress: Progress,
) -> _kernels.NormalMesh:
    mesh = traced.mesh
    return _kernels.remesh(
        mesh.vertices,
        get_vertex_attributes(mesh),
        confidence[traced.vertex_source] if len(confidence) else confidence,
        mesh.triangles,
        None if original is None else (original.vertices, original.triangles),
        levels=params.levels,
        base_triangles=target_base_triangles,
        base_error=np.inf if params.base_error is None else params.base_error,
        ignore_cost_limit=params.base_triangles is not None or params.base_error is not None,
        max_error=params.max_error or 0.0,
        butterfly=params.scheme == "butterfly",
        relaxations=params.relaxations,
        tolerance=params.tolerance,
        color_tolerance=params.color_tolerance,
        up=mesh.up,
        threads=params.threads or 0,
        progress=progress,
    )


def _find_nearest_triangles(mesh: Mesh, points: NDArray[np.float64]) -> NDArray[np.integer[Any]]:
    """Return the index of the triangle nearest to each point."""
    box = compute_bounding_box(mesh)
    box = np.stack([np.minimum(box[0], points.min(axis=0)), np.maximum(box[1], points.max(axis=0))])
    return RaycastingSurface(mesh, box).find_closest_points(points).triangles


def _cut_sheets(start: TrackedMesh, sheets: Sheets | None) -> TrackedMesh:
    """Return the mesh cut into its manifold sheets, or unchanged without sheets."""
    if sheets is None:
        return start
    sources = start.vertex_source[sheets.vertex_source], start.triangle_source[sheets.triangle_source]
    return TrackedMesh(build_sheet_mesh(start.mesh, sheets), *sources)


def _validate_confidence(values: ArrayLike | None, count: int) -> NDArray[np.float64]:
    if values is None:
        return np.zeros(0)
    array = np.asarray(values)
    if array.shape != (count,) or array.dtype.kind not in "biuf" or not np.isfinite(array).all():
        raise MeshError(
            USAGE_ARGUMENT_INVALID,
            (
                "confidence is {array_dtype} of shape {array_shape}; a finite number for "
                "each of the {count} vertices is expected."
            ),
            "mesh",
            array_dtype=array.dtype,
            array_shape=array.shape,
            count=count,
        )
    return array.astype(np.float64)


def _describe_tolerance(found: _kernels.NormalMesh, mesh: Mesh) -> dict[str, float | str]:
    """Return the result's tolerance as a diagonal ratio and in metres, and its origin."""
    if found.tolerance is None or found.tolerance_source is None:
        return {}
    return {
        "tolerance": found.tolerance,
        "tolerance_m": found.tolerance * _compute_diagonal(mesh),
        "tolerance_source": _TOLERANCE_SOURCES[found.tolerance_source],
    }


def _report_left_out(mesh: Mesh) -> None:
    has_normals = mesh.normals is not None or mesh.corner_normals is not None
    lost = {"normals": has_normals or None, "parts": mesh.part_ids}
    names = " and ".join(name for name, value in lost.items() if value is not None)
    if names:
        emit(
            LEVELS_LEFT_OUT.warning(
                "remesh left out: {names}; it keeps vertex colours and confidence.", names=names
            )
        )
    if mesh.texture is not None:
        emit(create_texture_warning("remesh"))


def _report_result(
    found: _kernels.NormalMesh, params: RemeshParams, target_base_triangles: int, split_count: int
) -> None:
    if split_count:
        emit(
            LEVELS_VERTICES_SPLIT.warning(
                "{count:,} pinched {were} split: each fan of triangles around it has its own copy.",
                count=split_count,
                were="vertex was" if split_count == 1 else "vertices were",
            )
        )
    base = len(found.triangles(0))
    asked = params.base_triangles is not None or params.levels is not None
    if asked and target_base_triangles and base > _MAX_BASE_RATIO * target_base_triangles:
        emit(
            LEVELS_BASE_LARGE.warning(
                "the base mesh has {base:,} triangles, not {wanted_base:,}: connected components, holes and "
                "handles are preserved, or the mesh cannot be refined well from fewer. The finest level has "
                "{finest:,} triangles; lower levels to reduce that.",
                base=base,
                wanted_base=target_base_triangles,
                finest=len(found.triangles(found.levels)),
            )
        )
    if sum(found.folded_counts):
        emit(
            LEVELS_FOLDED.warning(
                "{count:,} triangles in all levels ({finest:,} in the finest) are flipped relative to the "
                "surface or have no area.",
                count=sum(found.folded_counts),
                finest=found.folded_counts[-1],
            )
        )
    if params.max_error is not None and found.reached and found.reached[-1] > params.max_error:
        emit(
            LEVELS_NORMAL_MESH_INEXACT.unmet(
                "the finest level is up to {reached:.4g} m from the input, more than max_error "
                "({max_error:g} m)",
                remedy="increase levels or base_triangles.",
                reached=found.reached[-1],
                max_error=params.max_error,
            )
        )
