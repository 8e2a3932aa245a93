"""Simplification of textured meshes along their seams."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.simplification.cache_order import run_reordered
from scanloom.stages.simplification.codes import SIMPLIFY_COORDINATES_UNUSABLE
from scanloom.stages.simplification.color_weight import compute_color_weight
from scanloom.stages.simplification.corner_attributes import CornerAttributes, SimplifiedCorners
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.records.wedges import Wedges
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.seams.details import SeamsDetails
from scanloom.stages.simplification.seams.params import (
    DEFAULT_IMAGE_SIDE,
    MAX_SEAM_DRIFT_RATIO,
    SEAM_DRIFT_EDGES,
    SIMILAR_DISTANCE,
    SeamsParams,
)
from scanloom.stages.simplification.seams.similar_vertices import group_joinable_vertices
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_bounding_box
from scanloom.stages.surface.surface_color import get_vertex_attributes
from scanloom.stages.surface.texture import Texture, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas

RESULT_VERSION = 7

# Triangles per region of the collapse engine: with all their attributes, they fit into the CPU caches.
REGION_TRIANGLES = 2048

# Maximum of the default similarity distance, as a ratio of the median triangle side.
_MAX_SIMILAR_PER_SIDE = 0.01

Floats = NDArray[np.float64]


def run(task: Task[SeamsParams]) -> SimplificationResult[SeamsDetails]:
    """Simplify with method `seams`."""
    return run_reordered(task, _run_in_order)


def _run_in_order(task: Task[SeamsParams]) -> SimplificationResult[SeamsDetails]:
    return simplify_in_order(task, expected_triangles=task.triangles or 0)[0]


def simplify_in_order(
    task: Task[SeamsParams],
    *,
    expected_triangles: int,
    distance_bound: tuple[float, float, Floats] | None = None,
) -> tuple[SimplificationResult[SeamsDetails], float]:
    """Simplify a mesh without reordering it.

    Parameters
    ----------
    task : arguments of the method.
    expected_triangles : expected triangle count, from which the weights of colours and normals are derived.
    distance_bound : bound on the distance in metres, ratio of the bound that vertices may use, and factors
        (n,) on
        the bound per vertex; None for no bound.

    Returns
    -------
    result : SimplificationResult
    provable : metres; the bound of `distance_bound`, or the smallest provable distance if that is larger.
    """
    mesh, params, lock = task.mesh, task.params, task.lock
    low, high = compute_bounding_box(mesh) if len(mesh.triangles) else (np.zeros(3), np.zeros(3))
    origin = 0.5 * low + 0.5 * high
    copy_distance = _compute_similar_distance(mesh, float(np.linalg.norm(high - low)))
    distance = copy_distance if params.similar_distance is None else params.similar_distance
    sets, positions, is_separate = group_joinable_vertices(
        mesh.vertices, mesh.triangles, distance, copy_distance
    )
    lock = lock | is_separate
    attributes = _build_attributes(task, positions, origin, expected_triangles)
    texture = mesh.texture
    side = _find_largest_side(texture)
    count = len(mesh.triangles)
    has_uvs = np.zeros(count, bool) if texture is None else texture.has_uvs()
    found = _kernels.simplify_seams(
        positions - origin,
        sets,
        mesh.triangles,
        attributes.columns,
        has_uvs,
        np.full(count, -1, np.int32) if texture is None else texture.material_ids,
        np.full(count, -1, np.int32) if mesh.part_ids is None else mesh.part_ids,
        task.importance[mesh.triangles].mean(axis=1) if len(task.importance) else task.importance,
        lock,
        knobs=_build_kernel_options(params, texture, attributes.uv_scale, expected_triangles),
        fit=task.fit and distance_bound is None,
        within=distance_bound,
        running=task.make_kernel_options(REGION_TRIANGLES),
        progress=task.progress,
    )
    kernel_result = SimplifiedCorners(
        positions=found.vertices,
        triangles=found.triangles,
        corners=found.corners,
        corner_source=found.corner_source,
        vertex_source=found.vertex_source,
        triangle_source=found.triangle_source,
    )
    simplified_mesh, vertex_source = attributes.to_mesh(mesh, kernel_result)
    record = None if found.log is None else _build_record(mesh, attributes, lock, found.log)
    drift = found.seam_drift / attributes.uv_scale if attributes.uv_scale else 0.0
    result = SimplificationResult(
        mesh=simplified_mesh,
        vertex_source=vertex_source,
        triangle_source=found.triangle_source,
        method="seams",
        stopped_by=found.stopped_by,
        refused=found.refused,
        collapses=found.collapses,
        attempts=found.attempts,
        triangles_before=count,
        details=SeamsDetails(
            attribute_scale_m_per_level=attributes.color_scale,
            fitted=found.is_fitted,
            similar_distance_m=distance,
            joined_vertices=len(sets) - int(sets.max(initial=-1)) - 1,
            texture_scale_m=attributes.uv_scale,
            seam_drift=drift,
            seam_drift_texels=None if side is None else drift * side,
        ),
        record=record,
    )
    return result, found.provable_distance or 0.0


def _compute_similar_distance(mesh: Mesh, diagonal: float) -> float:
    """Compute the default distance (m) within which vertices count as duplicates.

    The limit by the median side makes it robust against outliers that enlarge the bounding box.
    """
    corners = mesh.vertices[mesh.triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    sides = sides[sides > 0]
    if not len(sides):
        return 0.0
    return min(SIMILAR_DISTANCE * diagonal, _MAX_SIMILAR_PER_SIDE * float(np.median(sides)))


def _build_record(
    mesh: Mesh, attributes: CornerAttributes, lock: NDArray[np.bool_], log: _kernels.SeamLog
) -> CollapseRecord:
    wedges = Wedges(
        attributes,
        corner_vertex=log.corner_vertex,
        corner_wedge=log.corner_wedge,
        removed=log.wedge_removed,
        survivor=log.wedge_survivor,
        when=log.wedge_when,
        changed=log.changed,
        changed_to=log.changed_to,
        changed_source=log.changed_source,
        changed_when=log.changed_when,
    )
    return CollapseRecord(mesh, log.removed, log.survivor, log.positions, lock, wedges=wedges)


def _build_attributes(
    task: Task[SeamsParams], positions: Floats, origin: Floats, target: int
) -> CornerAttributes:
    """Scale the corner attributes to metres by their weights."""
    mesh, params = task.mesh, task.params
    corners = mesh.triangles.reshape(-1)
    columns: list[NDArray[np.floating[Any]]] = []
    uv_scale = color_scale = normal_scale = 0.0
    texture = mesh.texture
    if texture is not None and texture.has_uvs().any():
        # A scale of 0 would lose the texture coordinates.
        uv_scale = max(params.texture_weight, 1e-9) * _compute_metres_per_image(mesh, positions)
        if not np.isfinite(uv_scale):
            raise MeshError(
                SIMPLIFY_COORDINATES_UNUSABLE,
                "texture coordinates are too small to be weighted against the shape",
                "mesh",
                remedy="create a new texture, or remove it.",
            )
        columns.append(texture.uvs.reshape(-1, 2) * uv_scale)
    else:
        columns.append(np.zeros((len(corners), 2)))
    if mesh.colors is not None:
        color_scale = task.attribute_scale or 0.0
        if task.attribute_scale is None:
            color_scale = compute_color_weight(mesh, target, task.threads)
        color_scale = max(color_scale, 1e-12)
        columns.append(get_vertex_attributes(mesh)[corners] * color_scale)
    normals = mesh.corner_normals.reshape(-1, 3) if mesh.corner_normals is not None else None
    if normals is None and mesh.normals is not None:
        normals = mesh.normals[corners]
    if normals is not None:
        normal_scale = max(params.normal_weight * _compute_metres_per_normal(mesh, positions, target), 1e-12)
        columns.append(normals * normal_scale)
    return CornerAttributes(
        origin=origin,
        positions=positions,
        columns=np.ascontiguousarray(np.hstack(columns)),
        uv_scale=uv_scale,
        color_scale=color_scale,
        normal_scale=normal_scale,
        has_uvs=uv_scale > 0,
        has_colors=mesh.colors is not None,
        has_normals=normals is not None,
    )


def _compute_metres_per_image(mesh: Mesh, positions: Floats) -> float:
    """Compute the mean surface length that the image's side covers, in metres."""
    assert mesh.texture is not None
    in_image = np.abs(compute_signed_areas(mesh.texture.uvs))
    has_area = in_image > 0
    if not has_area.any():
        # Palette: each triangle maps to a single texel, and every other colour is far away in the image.
        return float(np.linalg.norm(np.ptp(positions, axis=0))) or 1.0
    with np.errstate(over="ignore"):  # An infinite result is rejected by the caller.
        ratio = compute_areas(positions, mesh.triangles)[has_area].sum() / in_image[has_area].sum()
    return float(np.sqrt(ratio)) or 1.0


def _compute_metres_per_normal(mesh: Mesh, positions: Floats, target: int) -> float:
    """Compute the metres that weigh as much as a unit normal difference.

    On a surface of curvature radius r, an edge of length e deviates by e² / 8r at its centre. The normals at
    its ends differ by e / r. An eighth of the expected edge length balances the two.
    """
    area = float(compute_areas(positions, mesh.triangles).sum())
    return _compute_edge_length(area / max(target, 1)) / 8


def _compute_edge_length(area: float) -> float:
    """Compute the edge length of an equilateral triangle from its area."""
    return float(np.sqrt(area * 4 / np.sqrt(3)))


def _find_largest_side(texture: Texture | None) -> int | None:
    """Return the largest image side of a texture, in texels.

    The images are not decoded. The result is None without images.
    """
    images = () if texture is None else texture.images
    sizes = [image.size for image in images]
    return max((max(size) for size in sizes if size is not None), default=None)


def _build_kernel_options(
    params: SeamsParams, texture: Texture | None, uv_scale: float, target: int
) -> _kernels.SeamWeights:
    if params.max_seam_drift is None:
        # Repeating images cover the surface several times.
        covered = 1.0 if texture is None else max(float(np.abs(compute_signed_areas(texture.uvs)).sum()), 1.0)
        drift = min(SEAM_DRIFT_EDGES * _compute_edge_length(covered / max(target, 1)), MAX_SEAM_DRIFT_RATIO)
    else:
        drift = params.max_seam_drift / (_find_largest_side(texture) or DEFAULT_IMAGE_SIDE)
    return _kernels.SeamWeights(
        material_border_penalty=params.material_border_penalty,
        part_border_penalty=params.part_border_penalty,
        valence_penalty=params.valence_penalty,
        duplicate_penalty=params.duplicate_penalty,
        shape_weight=params.shape_weight,
        seam_drift=drift * uv_scale,
    )
