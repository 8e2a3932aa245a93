"""Near-planar patch segmentation, and simplification by retriangulating the patches."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.params import resolve
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.simplification.kernel_input import build_result_mesh, make_kernel_input, require_colors
from scanloom.stages.simplification.manifold_sheets import run_on_sheets, split_into_sheets, weld_into_sheets
from scanloom.stages.simplification.planar.bound_search import FewestTriangles, search_fewest_triangles
from scanloom.stages.simplification.planar.details import PlanarDetails
from scanloom.stages.simplification.planar.params import MAX_COLOR, PatchParams, PlanarParams
from scanloom.stages.simplification.planar.patches import Patches
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import compute_bounding_box
from scanloom.stages.surface.sheet_decomposition import Sheets
from scanloom.stages.surface.topology import require_measurable

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import PatchKeywords

RESULT_VERSION = 3

# Vertices, vertex attributes, triangles, and triangle labels that patches do not cross.
_SurfaceArrays: TypeAlias = tuple[NDArray[np.float64], NDArray[Any], NDArray[np.int32], NDArray[np.int32]]

_SHAPE_PER_DIAGONAL = 0.005
_MAX_COLOR_DISTANCE = 255 * math.sqrt(3)


def planar_patches(
    mesh: MeshLike,
    params: PatchParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[PatchKeywords],
) -> Patches:
    """Segment a mesh into connected near-planar patches.

    `simplify` retriangulates these patches, or patches of a tighter `max_shape` if they leave fewer
    triangles. It also splits patches that overlap when seen along their normal.

    A patch grows from a flat region, layer by layer. A triangle joins if its normal is within `patch_angle`
    of the patch's normal, which is the mean over previous layers. The normal must also be within
    `crease_angle` of the neighbour's normal. Beyond the paper, a patch stays between two planes with a
    distance of 0.8 `max_shape`. Its colours stay within 0.4 `max_color` of a linear function. Patches with
    less area than 4 `max_shape`² dissolve into neighbours, up to `noise_angle`, if the bounds allow. Patches
    do not cross borders of materials or parts.

    Parameters
    ----------
    mesh : in metres. Patches end at non-manifold edges and at edges with inconsistent orientation.
    params : PatchParams; single fields can be given as keywords instead.
    progress : called about ten times per second; an exception stops the segmentation.

    Returns
    -------
    Patches
        Sorted by decreasing area.

    Raises
    ------
    MeshError
        For an index out of range, a value that is not finite, or coordinates that are too large.
    UsageError
        For a parameter out of range, or a colour bound on a mesh without colours.
    """
    params = resolve(PatchParams, params, dict(changes))
    mesh = as_mesh(mesh)
    require_measurable(mesh, "mesh")
    kernel_arrays = make_kernel_input(mesh)
    cosines, bounds, threads = (
        _compute_cosines(params),
        _resolve_bounds(mesh, params.max_shape, params.max_color),
        params.threads or 0,
    )

    def find_patches(surface: _SurfaceArrays) -> _kernels.PlanarPatches:
        return _kernels.find_planar_patches(
            *surface, cosines=cosines, bounds=bounds, threads=threads, progress=progress
        )

    surface_arrays = kernel_arrays.vertices, kernel_arrays.attributes, mesh.triangles, _label_triangles(mesh)
    sheets = weld_into_sheets(mesh)
    if sheets is None:
        try:
            return _build_patches(find_patches(surface_arrays), kernel_arrays.origin)
        except _kernels.InvalidMeshError:
            # The mesh is not a manifold; its sheets are.
            sheets = split_into_sheets(mesh)
    in_sheets = find_patches(_select_sheets(surface_arrays, sheets))
    return _build_patches(in_sheets, kernel_arrays.origin, _map_to_mesh(mesh, sheets, in_sheets.input_patch))


def run(task: Task[PlanarParams]) -> SimplificationResult[PlanarDetails]:
    """Simplify with method `planar`.

    Raises
    ------
    UsageError
        For a colour bound on a mesh without colours.
    """
    mesh = task.mesh
    sheets = weld_into_sheets(mesh)
    if sheets is None:
        return _run_on_mesh(task)
    found = run_on_sheets(sheets, task, _run_on_mesh)
    patches = found.details.patches
    of_input = _map_to_mesh(mesh, sheets, patches.triangle_patch)
    return replace(found, details=replace(found.details, patches=replace(patches, triangle_patch=of_input)))


def _run_on_mesh(task: Task[PlanarParams]) -> SimplificationResult[PlanarDetails]:
    mesh = task.mesh
    kernel_arrays = make_kernel_input(mesh)
    shape, color = _resolve_bounds(mesh, task.max_shape, task.max_color)
    cosines = _compute_cosines(task.params)

    def run_search(
        surface: _SurfaceArrays, lock: NDArray[np.bool_]
    ) -> FewestTriangles[_kernels.PlanarResult]:
        return search_fewest_triangles(
            lambda bound, progress: _kernels.simplify_planar(
                *surface,
                lock,
                cosines=cosines,
                bounds=(bound, color),
                threads=task.threads,
                partial=task.keep_on_interrupt,
                progress=progress,
            ),
            vertices=surface[0],
            triangles=surface[2],
            max_shape=shape,
            diagonal=_compute_diagonal(mesh),
            progress=task.progress,
        )

    surface_arrays = kernel_arrays.vertices, kernel_arrays.attributes, mesh.triangles, _label_triangles(mesh)
    try:
        fewest = run_search(surface_arrays, task.lock)
        result = fewest.result
        triangles, source, triangle_source = result.triangles, result.vertex_source, result.triangle_source
        input_patch = result.input_patch
    except _kernels.InvalidMeshError:
        sheets = split_into_sheets(mesh)
        of_sheets = sheets.vertex_source
        # Triangles around contacts between sheets stay unchanged, so the contacts stay closed.
        fewest = run_search(_select_sheets(surface_arrays, sheets), task.lock[of_sheets] | sheets.is_contact)
        result = fewest.result
        source, one = np.unique(of_sheets[result.vertex_source], return_inverse=True)
        triangles = one.reshape(-1).astype(np.int32)[result.triangles]
        triangle_source = sheets.triangle_source[result.triangle_source]
        input_patch = _map_to_mesh(mesh, sheets, result.input_patch)
    colors = kernel_arrays.attributes[source].astype(np.float64)
    base_mesh = mesh.with_(part_ids=None, part_names=())
    if mesh.texture is not None and not mesh.texture.has_uvs().any():
        base_mesh = base_mesh.with_(texture=None)
    result_mesh = build_result_mesh(base_mesh, mesh.vertices[source], colors, triangles, source, "simplify")
    result_mesh = _transfer_attributes(result_mesh, mesh, triangle_source)
    # The bounds hold in exact arithmetic; the slack covers a few roundings of coordinates.
    slack = 1e-14 * float(np.abs(kernel_arrays.vertices).max(initial=0))
    bounds = result.bounds.reshape(-1, 2)[result.triangle_patch]
    shape_bound = np.where(bounds[:, 0] > 0, bounds[:, 0] + slack, 0)
    # The distance between black and white is the maximum.
    color_bound = np.minimum(bounds[:, 1], _MAX_COLOR_DISTANCE)
    with_color = mesh.colors is not None
    return SimplificationResult(
        mesh=result_mesh,
        vertex_source=source,
        triangle_source=triangle_source,
        method="planar",
        stopped_by="request" if fewest.is_partial else "bounds",
        refused=result.refused,
        collapses=0,
        attempts=0,
        triangles_before=len(mesh.triangles),
        details=PlanarDetails(
            shape_bound=shape_bound,
            color_bound=color_bound if with_color else None,
            shape_bound_m=float(shape_bound.max(initial=0)),
            color_bound_levels=float(color_bound.max(initial=0)) if with_color else None,
            max_shape_m=shape,
            patch_shape_m=fewest.max_shape,
            max_color_levels=color if with_color else None,
            kept_patches=int(result.kept_all_triangles.sum()),
            iterations=result.rounds,
            patches=_build_patches(result, kernel_arrays.origin, input_patch),
            triangle_patch=result.triangle_patch,
        ),
    )


def _label_triangles(mesh: Mesh) -> NDArray[np.int32]:
    """Label triangles (m,) by material and part; (0,) if all are equal."""
    key = np.zeros(len(mesh.triangles), np.int64)
    for ids in (None if mesh.texture is None else mesh.texture.material_ids, mesh.part_ids):
        if ids is not None:
            key = key << 32 | (ids.astype(np.int64) + 1)
    kinds, number = np.unique(key, return_inverse=True)
    return number.astype(np.int32) if len(kinds) > 1 else np.zeros(0, np.int32)


def _transfer_attributes(light: Mesh, mesh: Mesh, triangle_source: NDArray[np.int32]) -> Mesh:
    """Transfer parts, and materials without texture coordinates, to the result."""
    if mesh.part_ids is not None:
        light = light.with_(part_ids=mesh.part_ids[triangle_source], part_names=mesh.part_names)
    if mesh.texture is None or mesh.texture.has_uvs().any():
        return light
    return light.with_(texture=mesh.texture.select_triangles(triangle_source))


def _select_sheets(surface_arrays: _SurfaceArrays, sheets: Sheets) -> _SurfaceArrays:
    vertices, attributes, _, labels = surface_arrays
    of_sheets = sheets.vertex_source
    own = labels[sheets.triangle_source] if len(labels) else labels
    return vertices[of_sheets], attributes[of_sheets], sheets.triangles, own


def _map_to_mesh(mesh: Mesh, sheets: Sheets, patch: NDArray[np.int32]) -> NDArray[np.int32]:
    """Map patches of sheet triangles to triangles of the mesh.

    Triangles without a sheet get -1.
    """
    result = np.full(len(mesh.triangles), -1, np.int32)
    result[sheets.triangle_source] = patch
    return result


def _compute_cosines(params: PlanarParams) -> tuple[float, float, float]:
    """Compute the minimum cosines of the three angles.

    A third value above 1 disables `noise_angle`.
    """
    fidelity, detail, noise = (
        math.cos(math.radians(angle))
        for angle in (params.patch_angle, params.crease_angle, params.noise_angle)
    )
    # The floating-point cosine of 90° is slightly off zero.
    return max(fidelity, 0.0), max(detail, 0.0), noise if params.noise_angle > 0 else 2.0


def _resolve_bounds(mesh: Mesh, shape: float | None, max_color: float | None) -> tuple[float, float]:
    require_colors(mesh, max_color)
    if shape is None:
        # A mesh without extent needs no bound; 1 m is arbitrary.
        shape = _SHAPE_PER_DIAGONAL * _compute_diagonal(mesh) or 1.0
    if mesh.colors is None:
        return shape, math.inf
    return shape, MAX_COLOR if max_color is None else max_color


def _compute_diagonal(mesh: Mesh) -> float:
    low, high = compute_bounding_box(mesh) if len(mesh.triangles) else (np.zeros(3), np.zeros(3))
    return float(np.linalg.norm(high - low))


def _build_patches(
    found: _kernels.PlanarPatches,
    origin: NDArray[np.float64],
    triangle_patch: NDArray[np.int32] | None = None,
) -> Patches:
    return Patches(
        triangle_patch=found.input_patch if triangle_patch is None else triangle_patch,
        normals=found.normals,
        origins=found.origins + origin,
        areas=found.areas,
        triangles=found.faces,
        thickness=found.thickness,
        neighbour_test_count=found.neighbour_tests,
    )
