"""Bake all images of a textured model for its simplified mesh.

Each material class gets an atlas with at most as many texels as the images it replaces. The source point of
each texel is looked up once. All maps of the class are sampled there: base colour and alpha, tangent-space
normals, and all other maps of the materials.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.compare import measure_color_error
from scanloom.stages.comparing.distance_target import make_distance_target
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_bounding_box
from scanloom.stages.surface.texture import Image, Material, Texture, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas
from scanloom.stages.texturing.atlas_layout import AtlasLayout, lay_out_within
from scanloom.stages.texturing.bake import BakeResult
from scanloom.stages.texturing.class_baker import AtlasStats, ClassBaker, ClassMeshes, MaterialDraft
from scanloom.stages.texturing.codes import SIMPLIFY_IMAGES_SMALLER
from scanloom.stages.texturing.correspondence import Correspondence, locate_vertices
from scanloom.stages.texturing.image_format import EncodedImage, encode_within
from scanloom.stages.texturing.material_classes import MaterialClass, list_all_images
from scanloom.stages.texturing.texel_budgets import TexelBudget, compute_budgets, compute_densities

# Points of the original at which the colour error is sampled.
_COMPARED_SAMPLES = 30_000
# Minimum bytes per triangle in any mesh format. The bytes of removed triangles may be spent on images without
# enlarging the file.
_BYTES_PER_TRIANGLE = 12
# Texels of an atlas per visible texel of the old images, because resampling loses detail. The extra quarter
# improves four scans by 0.2 to 1.7 dB. The budget of a class limits it.
_OVERSAMPLING = 1.25
# Minimum texels of an atlas: padding between charts needs space.
_MIN_TEXELS = 64 * 64


def bake_materials(
    simplified: Mesh,
    original: Mesh,
    class_ids: NDArray[np.int32],
    original_class_ids: NDArray[np.int32],
    classes: Sequence[MaterialClass],
    *,
    progress: Progress = ignore_progress,
) -> BakeResult:
    """Bake the images of a model for its simplified mesh.

    Parameters
    ----------
    simplified : mesh whose texture and colours are replaced.
    original : textured mesh.
    class_ids : (q,) class of each triangle of the simplified mesh, index into `classes`.
    original_class_ids : (m,) class of each triangle of the original.
    classes : from `group_materials`.
    progress : called with the number of finished classes and their total.

    Returns
    -------
    Baked : the textured mesh, image sizes and colour error.

    Raises
    ------
    MeshError
        If a class cannot be laid out in an atlas.
    """
    with collecting() as diagnostics:
        baked = _bake_all(simplified, original, class_ids, original_class_ids, classes, progress)
    return replace(baked, diagnostics=tuple(diagnostics))


def _bake_all(
    simplified: Mesh,
    original: Mesh,
    class_ids: NDArray[np.int32],
    original_class_ids: NDArray[np.int32],
    classes: Sequence[MaterialClass],
    progress: Progress,
) -> BakeResult:
    assert original.texture is not None
    drafts: list[MaterialDraft | Material] = []
    uvs = np.zeros((len(simplified.triangles), 3, 2))
    material_ids = np.full(len(simplified.triangles), -1, np.int32)
    stats = AtlasStats()
    budgets = compute_budgets(original, original_class_ids, classes)
    for index, material_class in enumerate(classes):
        progress(index, len(classes))
        rows = np.flatnonzero(class_ids == index)
        original_rows = np.flatnonzero(original_class_ids == index)
        if not len(rows) or not len(original_rows):
            continue
        if not material_class.is_baked:
            if material_class.material_indices[0] >= 0:
                material_ids[rows] = len(drafts)
                drafts.append(original.texture.materials[material_class.material_indices[0]])
            continue
        part = ClassMeshes(
            _select_triangles(simplified, rows), _select_triangles(original, original_rows), rows
        )
        many = sum(other.is_baked for other in classes) > 1
        name = f"baked-{index + 1}" if many else "baked"
        pages, page_drafts = _bake_class(part, material_class, budgets[index], name, stats)
        uvs[rows] = pages.uvs
        material_ids[rows] = len(drafts) + pages.images
        drafts += page_drafts
    sources = list_all_images(original, classes)
    source_bytes = sum(len(image.file_bytes) for image in sources)
    removed_triangles = max(len(original.triangles) - len(simplified.triangles), 0)
    encoded, scale = encode_within(
        [
            (pixels, form)
            for draft in drafts
            if isinstance(draft, MaterialDraft)
            for _, pixels, form in draft.canvases
        ],
        source_bytes + _BYTES_PER_TRIANGLE * removed_triangles,
    )
    materials = _attach_images(drafts, encoded)
    if scale < 1:
        emit(
            SIMPLIFY_IMAGES_SMALLER.warning(
                "baked images have {scale:.0%} of the resolution of the original images along each side, so "
                "that the file is no larger than the input.",
                scale=scale,
            )
        )
    mesh = simplified.with_(
        colors=None,
        texture=Texture(uvs, material_ids, tuple(materials)),
    )
    box = compute_bounding_box(original, mesh)
    color = measure_color_error(
        make_distance_target(original, box), make_distance_target(mesh, box), _COMPARED_SAMPLES
    )
    assert color is not None
    texel_areas = np.abs(compute_signed_areas(uvs * _get_image_sizes(mesh)))
    is_laid = texel_areas > 0
    area = compute_areas(mesh.vertices, mesh.triangles)
    return BakeResult(
        mesh=mesh,
        sizes=tuple(image.size for image in encoded),
        texel_size=math.sqrt(float(area[is_laid].sum()) / max(float(texel_areas.sum()), 1e-300)),
        coverage=stats.surface_texels / max(stats.texels, 1),
        charts=stats.charts,
        padding=int(stats.padding) if math.isfinite(stats.padding) else 0,
        samples=1,
        turned_ratio=stats.turned_texels / max(stats.surface_texels, 1),
        color=color,
        vertex_color=None,
        image_bytes=sum(len(image.data) for image in encoded),
        source_image_bytes=source_bytes,
        resolution_scale=scale,
        quality=min((image.quality for image in encoded if image.quality is not None), default=None),
    )


def _attach_images(
    drafts: Sequence[MaterialDraft | Material], encoded: Sequence[EncodedImage]
) -> list[Material]:
    """Create materials from drafts and their encoded images, in the same order."""
    rest = iter(encoded)
    materials = []
    for draft in drafts:
        if isinstance(draft, Material):
            materials.append(draft)
            continue
        images = [Image(name=name, encoded=next(rest).data) for name, _, _ in draft.canvases]
        materials.append(draft.build({path: images[index] for path, index in draft.image_indices.items()}))
    return materials


def _get_image_sizes(mesh: Mesh) -> NDArray[np.float64]:
    """Return the image size of each triangle, (m, 1, 2); 0 without an image."""
    assert mesh.texture is not None
    sizes = [(0, 0) if m.image is None else m.image.pixels.shape[1::-1] for m in mesh.texture.materials]
    return np.array([*sizes, (0, 0)], float)[mesh.texture.material_ids][:, None]


def _select_triangles(mesh: Mesh, rows: NDArray[np.intp]) -> Mesh:
    """Select triangles of a mesh and the vertices that they use."""
    used, local = np.unique(mesh.triangles[rows], return_inverse=True)
    triangles = local.reshape(-1, 3).astype(np.int32)
    return replace(
        mesh.with_triangles(triangles, rows),
        vertices=mesh.vertices[used],
        colors=None if mesh.colors is None else mesh.colors[used],
        normals=None if mesh.normals is None else mesh.normals[used],
    )


def _bake_class(
    part: ClassMeshes, material_class: MaterialClass, budget: TexelBudget, name: str, stats: AtlasStats
) -> tuple[AtlasLayout, list[MaterialDraft]]:
    total = float(budget.covered.sum())
    limit = None if budget.texels is None else max(budget.texels, _MIN_TEXELS)
    vertices = locate_vertices(part.simplified, part.original)
    nearest = vertices.nearest.triangles[part.original.triangles]
    densities = compute_densities(part.simplified, part.original, nearest, budget.covered)
    pages = lay_out_within(
        part.simplified,
        densities,
        texels=max(_OVERSAMPLING * total, 1.0),
        max_texels=limit,
        max_side=min(1 << max(budget.max_side - 1, 1).bit_length(), 8192),
    )
    correspondence = Correspondence(part.simplified, part.original, pages, vertices)
    stats.charts += int(pages.charts.max()) + 1
    stats.padding = min(stats.padding, pages.padding)
    baker = ClassBaker(part, material_class, budget, pages, total)
    found = []
    for page in range(len(pages.sizes)):
        label = f"{name}-{page + 1}" if len(pages.sizes) > 1 else name
        found.append(baker.bake_page(correspondence, page, label, stats))
    return pages, found
