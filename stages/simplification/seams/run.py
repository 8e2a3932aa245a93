"""Simplification of textured meshes, along their seams."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import MeshError
from scanloom.stages.simplification.codes import SIMPLIFY_COORDINATES_UNWEIGHABLE
from scanloom.stages.simplification.color_weight import color_weight
from scanloom.stages.simplification.corner_attributes import CornerAttributes, LightCorners
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.records.wedges import Wedges
from scanloom.stages.simplification.reordered import run_reordered
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.seams.details import SeamsDetails
from scanloom.stages.simplification.seams.params import (
    ASSUMED_SIDE,
    MAX_SEAM_DRIFT_RATIO,
    SEAM_DRIFT_EDGES,
    SIMILAR_DISTANCE,
    SeamsParams,
)
from scanloom.stages.simplification.seams.similar import joinable_sets
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.color import attributes_of
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import bounding_box
from scanloom.stages.surface.texture import Texture, signed_areas
from scanloom.stages.surface.topology import areas

RESULT_VERSION = 6

# Triangles worked on at a time: with all that is known of them they fit into the caches.
REGION_TRIANGLES = 2048

# The default distance of similar vertices is at most this share of the median side of a triangle.
_SIMILAR_PER_SIDE = 0.01

Floats = NDArray[np.float64]


def run(task: Task[SeamsParams]) -> Simplified[SeamsDetails]:
    """Simplify with method `seams`."""
    return run_reordered(task, _as_it_is)


def _as_it_is(task: Task[SeamsParams]) -> Simplified[SeamsDetails]:
    return simplified(task, expected=task.triangles or 0)[0]


def simplified(
    task: Task[SeamsParams], *, expected: int, within: tuple[float, float, Floats] | None = None
) -> tuple[Simplified[SeamsDetails], float]:
    """Simplify a mesh in the order it has.

    Parameters
    ----------
    expected : triangles that may be left, which the weights of colours and normals are made for.
    within : metres, the share of them that vertices of either surface may be off, and a factor of that for
        each vertex (n,); None for no such bound.

    Returns
    -------
    result : Simplified
    provable : metres; the first of `within`, or the least distance that can be proven if that is larger.
    """
    mesh, params, lock = task.mesh, task.params, task.lock
    low, high = bounding_box(mesh) if len(mesh.triangles) else (np.zeros(3), np.zeros(3))
    origin = 0.5 * low + 0.5 * high
    copy_distance = _similar_distance(mesh, float(np.linalg.norm(high - low)))
    distance = copy_distance if params.similar_distance is None else params.similar_distance
    sets, positions, apart = joinable_sets(mesh.vertices, mesh.triangles, distance, copy_distance)
    lock = lock | apart
    attributes = _attributes(task, positions, origin, expected)
    texture = mesh.texture
    side = _largest_side(texture)
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
        knobs=_knobs(params, texture, attributes.uv_scale, expected),
        fit=task.fit and within is None,
        within=within,
        running=task.running(REGION_TRIANGLES),
        progress=task.progress,
    )
    left = LightCorners(
        places=found.vertices,
        triangles=found.triangles,
        corners=found.corners,
        corner_source=found.corner_source,
        vertex_source=found.vertex_source,
        triangle_source=found.triangle_source,
    )
    light, vertex_source = attributes.as_mesh(mesh, left)
    record = None if found.log is None else _record(mesh, attributes, lock, found.log)
    drift = found.seam_drift / attributes.uv_scale if attributes.uv_scale else 0.0
    result = Simplified(
        mesh=light,
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
            fitted=found.fitted,
            similar_distance_m=distance,
            joined_vertices=len(sets) - int(sets.max(initial=-1)) - 1,
            texture_scale_m=attributes.uv_scale,
            seam_drift=drift,
            seam_drift_texels=None if side is None else drift * side,
        ),
        record=record,
    )
    return result, found.provable or 0.0


def _similar_distance(mesh: Mesh, diagonal: float) -> float:
    """Return the distance (m) of copies of a vertex, which one vertex far away does not make larger."""
    corners = mesh.vertices[mesh.triangles]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    sides = sides[sides > 0]
    if not len(sides):
        return 0.0
    return min(SIMILAR_DISTANCE * diagonal, _SIMILAR_PER_SIDE * float(np.median(sides)))


def _record(
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
    return CollapseRecord(mesh, log.removed, log.survivor, log.places, lock, wedges=wedges)


def _attributes(task: Task[SeamsParams], positions: Floats, origin: Floats, target: int) -> CornerAttributes:
    """Return what the corners carry, each attribute in metres by its weight."""
    mesh, params = task.mesh, task.params
    corners = mesh.triangles.reshape(-1)
    columns: list[NDArray[np.floating[Any]]] = []
    uv_scale = color_scale = normal_scale = 0.0
    texture = mesh.texture
    if texture is not None and texture.has_uvs().any():
        # A weight of 0 would leave no place for the coordinates.
        uv_scale = max(params.texture_weight, 1e-9) * _metres_per_image(mesh, positions)
        if not np.isfinite(uv_scale):
            raise MeshError(
                SIMPLIFY_COORDINATES_UNWEIGHABLE,
                "its texture coordinates are too small to be weighed against its shape",
                "mesh",
                remedy="make a new texture, or leave it out.",
            )
        columns.append(texture.uvs.reshape(-1, 2) * uv_scale)
    else:
        columns.append(np.zeros((len(corners), 2)))
    if mesh.colors is not None:
        color_scale = task.attribute_scale or 0.0
        if task.attribute_scale is None:
            color_scale = color_weight(mesh, target, task.threads)
        color_scale = max(color_scale, 1e-12)
        columns.append(attributes_of(mesh)[corners] * color_scale)
    normals = mesh.corner_normals.reshape(-1, 3) if mesh.corner_normals is not None else None
    if normals is None and mesh.normals is not None:
        normals = mesh.normals[corners]
    if normals is not None:
        normal_scale = max(params.normal_weight * _metres_per_normal(mesh, positions, target), 1e-12)
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


def _metres_per_image(mesh: Mesh, positions: Floats) -> float:
    """Return the length on the surface that the image's side covers, in the mean over the surface's area."""
    assert mesh.texture is not None
    in_image = np.abs(signed_areas(mesh.texture.uvs))
    seen = in_image > 0
    if not seen.any():
        # Every triangle has one texel: a palette. Any other colour is far away.
        return float(np.linalg.norm(np.ptp(positions, axis=0))) or 1.0
    with np.errstate(over="ignore"):  # What comes out infinite is refused.
        ratio = areas(positions, mesh.triangles)[seen].sum() / in_image[seen].sum()
    return float(np.sqrt(ratio)) or 1.0


def _metres_per_normal(mesh: Mesh, positions: Floats, target: int) -> float:
    """Return the length that weighs as much as a difference of 1 of normals.

    On a round surface of radius r, an edge of length e is e² / 8r off in its middle, and the normals of its
    ends are e / r apart: an eighth of the length of the edges that will be left balances the two.
    """
    area = float(areas(positions, mesh.triangles).sum())
    return _edge_of_triangle(area / max(target, 1)) / 8


def _edge_of_triangle(area: float) -> float:
    """Return the edge length of an equilateral triangle."""
    return float(np.sqrt(area * 4 / np.sqrt(3)))


def _largest_side(texture: Texture | None) -> int | None:
    """Return the largest side of a texture's images in texels, without decoding them; None without images."""
    images = () if texture is None else texture.images
    sizes = [image.size for image in images]
    return max((max(size) for size in sizes if size is not None), default=None)


def _knobs(params: SeamsParams, texture: Texture | None, uv_scale: float, target: int) -> _kernels.SeamKnobs:
    if params.max_seam_drift is None:
        # An image that repeats covers the surface several times.
        covered = 1.0 if texture is None else max(float(np.abs(signed_areas(texture.uvs)).sum()), 1.0)
        drift = min(SEAM_DRIFT_EDGES * _edge_of_triangle(covered / max(target, 1)), MAX_SEAM_DRIFT_RATIO)
    else:
        drift = params.max_seam_drift / (_largest_side(texture) or ASSUMED_SIDE)
    return _kernels.SeamKnobs(
        across_materials=params.across_textures,
        across_parts=params.across_parts,
        valence=params.valence_penalty,
        wedges=params.set_penalty,
        shape=params.shape_weight,
        seam_drift=drift * uv_scale,
    )
