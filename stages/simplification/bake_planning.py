"""Simplification of textured models without texture seams, and baking of new images.

Texture coordinates would restrict collapses at every seam. Without them, only three kinds of borders remain:
between material classes that need separate images, between parts, and at sharp edges.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.compare import CompareParams, compare, compare_needle_safe, measure_color_error
from scanloom.stages.comparing.distance_target import make_distance_target
from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.params import find_changed
from scanloom.stages.simplification.codes import SIMPLIFY_IMAGES_KEPT
from scanloom.stages.simplification.kernel_input import create_texture_warning
from scanloom.stages.simplification.methods import METHODS
from scanloom.stages.simplification.params import AUTO, SimplifyParams
from scanloom.stages.simplification.result import KeptImages, SimplificationResult
from scanloom.stages.simplification.seams.params import SIMILAR_DISTANCE
from scanloom.stages.simplification.seams.similar_vertices import group_joinable_vertices
from scanloom.stages.surface.equal_positions import find_equal_positions
from scanloom.stages.surface.formats.gltf_materials import has_images
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.surface_color import decode_material_image, is_textured
from scanloom.stages.surface.texture import Material, Texture, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.bake import bake
from scanloom.stages.texturing.bake_materials import bake_materials
from scanloom.stages.texturing.material_classes import MaterialClass, group_materials

# Parameters that only apply to preserved texture coordinates or images.
_KEPT_UV_PARAMETERS = frozenset(
    ("max_color", "seams.max_seam_drift", "seams.texture_weight", "seams.material_border_penalty")
)
# Images that repeat more often on the surface, such as brick walls, would lose detail in an atlas of their
# size.
_MAX_REPEATS = 2.0
# Maximum ratio of the surface with less than one texel per triangle, as with palettes. Above it, an atlas
# with the same number of texels would lose the colours.
_MAX_PALETTE_RATIO = 0.5
# Default bound on shape, as a ratio of the model's size: invisible in a rendering of 1000 pixels.
_MAX_SHAPE_PER_SIZE = 1e-3
# Minimum length of the mean normal at a vertex to treat its normals as one: about 5 degrees between them.
_MIN_SMOOTH_LENGTH = 0.996
# Maximum distance between duplicate vertices, as a ratio of the median triangle side.
_MAX_SIMILAR_PER_SIDE = 0.01
# For a triangle count, the model's own images are kept under three conditions. Baking loses visibly (RMS
# above `_VISIBLE_COLOR_LEVELS` levels). The colour error is below `_MAX_COLOR_RATIO` of the baked one. The
# shape error is at most `_MAX_SHAPE_RATIO` of the baked one, or below `_INVISIBLE_SHAPE_RATIO` of the
# diagonal. For example, a can with small print has 44 dB with its own images at 10 %, and 34 dB with the same
# number of new texels.
_VISIBLE_COLOR_LEVELS = 3.0
_MAX_COLOR_RATIO = 0.35
_MAX_SHAPE_RATIO = 2.5
_INVISIBLE_SHAPE_RATIO = 2e-4
# Maximum ratio of the triangle counts with own and with baked images.
_MAX_COUNT_RATIO = 1.02
# Samples per surface for the comparison, and samples of the original for a cheaper test before it; the factor
# on the colour limit above which the cheaper test decides.
_COMPARISON_SAMPLES, _PRETEST_SAMPLES = 20_000, 5_000
_CLEAR_MARGIN = 1.5
# Maximum number of vertices on texture seams per triangle of the result, to try the model's own images. The
# can has 0.08; of 35 models above 0.2, none would keep its images at ratios 0.1 and 0.03.
_MAX_SEAM_RATIO = 0.2
# Tolerance for equal texture coordinates.
_UV_TOLERANCE = 1e-6
# Ratio of the surface at each end of each axis that is ignored as outliers when measuring the size.
_OUTLIER_RATIO = 0.005


@dataclass(frozen=True, eq=False)
class BakePlan:
    """Shape to simplify, and material classes to bake afterwards.

    Attributes
    ----------
    original : mesh as given.
    shape : mesh without texture coordinates. If there are several classes, they are its materials.
    class_ids : (m,) int32, class of each triangle of the original.
    classes : material classes; empty if vertex colours are baked.
    """

    original: Mesh
    shape: Mesh
    class_ids: NDArray[np.int32]
    classes: tuple[MaterialClass, ...]

    @property
    def max_displacement(self) -> float:
        """Maximum distance between vertices of `shape` and of the original, in metres."""
        return float(np.linalg.norm(self.shape.vertices - self.original.vertices, axis=1).max(initial=0.0))

    def bake(self, found: SimplificationResult[Any]) -> SimplificationResult[Any]:
        """Bake images for the simplified mesh."""
        mesh = found.mesh
        if not compute_areas(mesh.vertices, mesh.triangles).any():
            emit(create_texture_warning("simplify"))
            return replace(found, mesh=mesh.with_(texture=None))
        if not self.classes:
            baked = bake(mesh, self.original, normal_map=False, occlusion_map=False)
        else:
            if self.shape.texture is not None and mesh.texture is not None:
                class_ids = mesh.texture.material_ids
            else:
                class_ids = self.class_ids[found.triangle_source]
            if not any(self.classes[number].is_baked for number in np.unique(class_ids)):
                # All triangles with an image are gone.
                emit(create_texture_warning("simplify"))
                return replace(found, mesh=mesh.with_(texture=None))
            baked = bake_materials(mesh, self.original, class_ids, self.class_ids, self.classes)
        parts = self.original.part_ids
        mesh = baked.mesh
        if parts is not None and mesh.part_ids is None and len(np.unique(parts)) == 1:
            part_ids = np.full(len(mesh.triangles), parts[0], np.int32)
            mesh = mesh.with_(part_ids=part_ids, part_names=self.original.part_names)
        return replace(found, mesh=mesh, baked=replace(baked, mesh=mesh))


def has_texture_images(mesh: Mesh) -> bool:
    """Return True if a mesh has texture coordinates and decodable images."""
    texture = mesh.texture
    if texture is None or not texture.has_uvs().any():
        return False
    used = np.unique(texture.material_ids)
    materials = [texture.materials[number] for number in used[used >= 0]]
    return any(decode_material_image(material) is not None or has_images(material) for material in materials)


def plan_baking(
    mesh: Mesh, params: SimplifyParams, *, record: bool
) -> tuple[BakePlan | None, Diagnostic | None]:
    """Plan the baking of a mesh, or decide to keep its images.

    Parameters
    ----------
    mesh : the input.
    params : parameters of `simplify`.
    record : True if collapses are recorded, which is possible with one set of texture coordinates only.

    Returns
    -------
    plan : BakePlan, or None if nothing is baked.
    reason : warning about images that are kept; None if the parameters determine the choice.
    """
    if params.keep_uv or params.bake is False:
        return None, None
    is_image = has_texture_images(mesh)
    if not is_image:
        return (_plan_color_baking(mesh), None) if params.bake else (None, None)
    if params.bake is None:
        carrying = [method.name for method in METHODS if method.capabilities.texture]
        is_auto = params.method == AUTO
        is_kept = not _KEPT_UV_PARAMETERS.isdisjoint(find_changed(params))
        if params.method in carrying or (is_auto and (record or is_kept)):
            return None, None
    class_ids, classes = group_materials(mesh)
    if params.bake is None and (reason := _find_reason_to_keep(mesh)) is not None:
        return None, reason
    return BakePlan(mesh, _strip_texture(mesh, class_ids, classes), class_ids, classes), None


def is_visibly_different(found: SimplificationResult[Any]) -> bool:
    """Return True if baked images differ visibly from the model's own."""
    color = None if found.baked is None else found.baked.color
    return color is not None and color.rmse > _VISIBLE_COLOR_LEVELS


def exceeds_count(found: SimplificationResult[Any], triangles: int) -> bool:
    """Return True if a result clearly exceeds a target triangle count."""
    return len(found.mesh.triangles) > _MAX_COUNT_RATIO * triangles


def is_better_baked(mesh: Mesh, baked: SimplificationResult[Any], kept: SimplificationResult[Any]) -> bool:
    """Return True if baking gives fewer triangles and no larger errors.

    Parameters
    ----------
    mesh : the input.
    baked, kept : results with baked images, and with the model's own.
    """
    if len(baked.mesh.triangles) >= len(kept.mesh.triangles):
        return False
    of_baked, of_kept = (compare(mesh, one.mesh, samples=_COMPARISON_SAMPLES) for one in (baked, kept))
    if of_baked.color is None or of_kept.color is None:
        return False
    return bool(of_baked.color.rmse <= of_kept.color.rmse and of_baked.symmetric.rms <= of_kept.symmetric.rms)


def has_few_seams(mesh: Mesh, triangles: int) -> bool:
    """Return True if few vertices are on seams for a triangle count."""
    texture = mesh.texture
    assert texture is not None
    sets, first = find_equal_positions(mesh.vertices)
    corners = sets[mesh.triangles].reshape(-1)
    # Representative corner of each vertex, with which its other corners are compared.
    one = np.zeros(len(first), np.int64)
    one[corners] = np.arange(len(corners))
    other = one[corners]
    u, v = texture.uvs.reshape(-1, 2).T
    material_ids = np.repeat(texture.material_ids, 3)
    is_other = (np.abs(u - u[other]) > _UV_TOLERANCE) | (np.abs(v - v[other]) > _UV_TOLERANCE)
    is_other |= material_ids != material_ids[other]
    is_seam = np.zeros(len(first), bool)
    is_seam[corners[is_other]] = True
    return int(np.count_nonzero(is_seam)) <= _MAX_SEAM_RATIO * triangles


def choose_texture(
    mesh: Mesh, baked: SimplificationResult[Any], kept: SimplificationResult[Any]
) -> SimplificationResult[Any]:
    """Choose baked images or the model's own by their errors.

    Parameters
    ----------
    mesh : the input.
    baked, kept : results with the same target triangle count.
    """
    if len(kept.mesh.triangles) > _MAX_COUNT_RATIO * len(baked.mesh.triangles) or baked.baked is None:
        return baked
    box = compute_bounding_box(mesh, baked.mesh, kept.mesh)
    original, kept_surface = (
        NeedleSafeSurface(RaycastingSurface(one, box), box) for one in (mesh, kept.mesh)
    )
    color = measure_color_error(
        make_distance_target(mesh, box, original),
        make_distance_target(kept.mesh, box, kept_surface),
        _PRETEST_SAMPLES,
    )
    baked_color = baked.baked.color
    if (
        color is None
        or baked_color is None
        or color.rmse >= _CLEAR_MARGIN * _MAX_COLOR_RATIO * baked_color.rmse
    ):
        return baked
    baked_surface = NeedleSafeSurface(RaycastingSurface(baked.mesh, box), box)
    of_baked, of_kept = (
        compare_needle_safe(original, one, CompareParams(samples=_COMPARISON_SAMPLES))
        for one in (baked_surface, kept_surface)
    )
    if of_baked.color is None or of_kept.color is None:
        return baked
    max_shape = max(_MAX_SHAPE_RATIO * of_baked.symmetric.rms, _INVISIBLE_SHAPE_RATIO * of_kept.diagonal)
    if of_kept.color.rmse >= _MAX_COLOR_RATIO * of_baked.color.rmse or of_kept.symmetric.rms > max_shape:
        return baked
    return replace(kept, kept_images=KeptImages(of_kept.color.rmse, of_baked.color.rmse))


def derive_max_shape(mesh: Mesh) -> float:
    """Derive the default bound on shape, in metres, from the model's size.

    The size is the diagonal of the bounding box. The outermost 0.5 % of the surface on each side are ignored,
    so that stray triangles have no effect.
    """
    corners = mesh.triangles.reshape(-1)
    weights = np.repeat(compute_areas(mesh.vertices, mesh.triangles), 3)
    low, high = np.zeros(3), np.zeros(3)
    for axis in range(3):
        values = mesh.vertices[corners, axis]
        order = np.argsort(values)
        before = np.cumsum(weights[order])
        ends = np.searchsorted(before, np.array([_OUTLIER_RATIO, 1 - _OUTLIER_RATIO]) * before[-1])
        low[axis], high[axis] = values[order][ends.clip(0, len(values) - 1)]
    return _MAX_SHAPE_PER_SIZE * float(np.linalg.norm(high - low))


def _plan_color_baking(mesh: Mesh) -> BakePlan:
    """Plan the baking of vertex colours."""
    shape = mesh if not is_textured(mesh) else mesh.with_(texture=None)
    return BakePlan(mesh, shape, np.zeros(len(mesh.triangles), np.int32), ())


def _strip_texture(mesh: Mesh, class_ids: NDArray[np.int32], classes: tuple[MaterialClass, ...]) -> Mesh:
    """Remove texture coordinates and colours; keep classes as materials."""
    has_parts = mesh.part_ids is not None and len(np.unique(mesh.part_ids)) > 1
    bare = mesh.with_(colors=None, texture=None)
    if not has_parts:
        bare = bare.with_(part_ids=None, part_names=())
    bare = _join_copies(_smooth_normals(bare))
    if len(classes) == 1:
        return bare
    uvs = np.zeros((len(mesh.triangles), 3, 2))
    materials = tuple(Material(f"class {index}") for index in range(len(classes)))
    return bare.with_(texture=Texture(uvs, class_ids, materials))


def _join_copies(mesh: Mesh) -> Mesh:
    """Move duplicate vertices that rounding has separated to one position."""
    sides = mesh.vertices[mesh.triangles] - np.roll(mesh.vertices[mesh.triangles], 1, axis=1)
    lengths = np.linalg.norm(sides, axis=2)
    if not lengths.any():
        return mesh
    low, high = compute_bounding_box(mesh)
    distance = min(
        SIMILAR_DISTANCE * float(np.linalg.norm(high - low)),
        _MAX_SIMILAR_PER_SIDE * float(np.median(lengths[lengths > 0])),
    )
    _, positions, _ = group_joinable_vertices(mesh.vertices, mesh.triangles, distance)
    return mesh.with_(vertices=positions)


def _smooth_normals(mesh: Mesh) -> Mesh:
    """Replace corner normals by vertex normals if no edge is sharp.

    Files duplicate vertices along texture seams, with normals that differ by rounding.
    """
    if mesh.corner_normals is None:
        return mesh
    _, place = np.unique(mesh.vertices, axis=0, return_inverse=True)
    place = place.reshape(-1)
    at = place[mesh.triangles.reshape(-1)]
    normals = mesh.corner_normals.reshape(-1, 3)
    sums = np.stack([np.bincount(at, normals[:, axis], minlength=len(place)) for axis in range(3)], axis=1)
    lengths = np.linalg.norm(sums, axis=1)
    counts = np.bincount(at, (normals != 0).any(axis=1), minlength=len(place))
    if (lengths < _MIN_SMOOTH_LENGTH * counts).any():
        return mesh
    unit = np.divide(sums, lengths[:, None], out=np.zeros_like(sums), where=lengths[:, None] > 0)
    return mesh.with_(normals=unit[place], corner_normals=None)


def _find_reason_to_keep(mesh: Mesh) -> Diagnostic | None:
    """Return a warning if baking would degrade the images; else None."""
    texture = mesh.texture
    assert texture is not None
    spread = np.abs(compute_signed_areas(texture.uvs))
    area = compute_areas(mesh.vertices, mesh.triangles)
    shown = np.zeros(len(spread))
    total, seen = 0.0, set()
    for number, material in enumerate(texture.materials):
        pixels = decode_material_image(material)
        is_of_material = texture.material_ids == number
        if pixels is None or not is_of_material.any():
            continue
        count = pixels.shape[0] * pixels.shape[1]
        shown[is_of_material] = spread[is_of_material] * count
        if id(material.image) not in seen:
            seen.add(id(material.image))
            total += count
    if not total:
        return None
    if shown.sum() > _MAX_REPEATS * total:
        return SIMPLIFY_IMAGES_KEPT.warning(
            "the images repeat on the surface, and an atlas with as few texels would lose "
            "detail: texture coordinates and images are kept",
            remedy="bake=True bakes an atlas anyway.",
        )
    if area[shown < 1].sum() > _MAX_PALETTE_RATIO * area.sum():
        return SIMPLIFY_IMAGES_KEPT.warning(
            "the images are palettes with a single texel per triangle: texture coordinates "
            "and images are kept",
            remedy="bake=True bakes an atlas anyway.",
        )
    return None
