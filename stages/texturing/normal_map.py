"""Normal map of a textured mesh within a byte limit."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.files.image_bytes import encode_image
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.surface.formats.gltf_materials import CLAMP_SAMPLER, GltfMaterialSource, make_lit_source
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image, Material
from scanloom.stages.texturing.atlas_layout import AtlasLayout
from scanloom.stages.texturing.detail_maps import DetailBaker
from scanloom.stages.texturing.shading_error import ShadingComparison, ShadingError
from scanloom.stages.texturing.shading_normals import add_shading_normals

# JPEG qualities that are tried if PNG is too large. Below 80, flat surfaces get a tilt of almost a degree.
_QUALITIES = (95, 90, 85, 80)
# A map resolves all details of the original if its texels are smaller than this ratio of an edge.
_RESOLVED_EDGES = 0.3


@dataclass(frozen=True, eq=False)
class NormalMapResult:
    """Mesh with a normal map.

    Attributes
    ----------
    mesh : the mesh with normals and the normal map; None if no map fits and lowers the shading error.
    error_before, error_after : shading error of the mesh without normals and map, and with both. The second
        is None if no map fits.
    image_bytes : bytes of the images of the map.
    sizes : (width, height) of each image.
    format : "png" or "jpeg".
    quality : JPEG quality; None for PNG.
    """

    mesh: Mesh | None
    error_before: ShadingError
    error_after: ShadingError | None
    image_bytes: int = 0
    sizes: tuple[tuple[int, int], ...] = ()
    format: str | None = None
    quality: int | None = None

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics for JSON."""
        return {
            "is_written": self.mesh is not None,
            "shading_error_before": self.error_before.to_dict(),
            "shading_error_after": self.error_after and self.error_after.to_dict(),
            "image_bytes": self.image_bytes,
            "images": [list(size) for size in self.sizes],
            "format": self.format,
            "quality": self.quality,
        }


@dataclass(frozen=True, eq=False)
class _Encoding:
    """Encoded images of a normal map, and the mesh with them."""

    mesh: Mesh
    error: ShadingError
    data: Sequence[bytes]
    sizes: tuple[tuple[int, int], ...]
    format: str
    quality: int | None


def bake_normal_map(mesh: Mesh, original: Mesh, pages: AtlasLayout, max_bytes: float) -> NormalMapResult:
    """Bake the normal map with the smallest shading error that a byte limit allows.

    Resolution and file format are chosen by the measured error.

    Parameters
    ----------
    mesh : textured mesh without normals.
    original : mesh in the same coordinates with more detail.
    pages : atlas of the texture.
    max_bytes : limit of the images of the map.
    """
    smooth = add_shading_normals(mesh, pages.uvs)
    baker = DetailBaker(smooth, original, pages)
    comparison = ShadingComparison(mesh, original, baker.original_normals)
    before = comparison.measure(mesh)

    def bake(factor: int) -> _Encoding | None:
        images = baker.bake_normals(factor)
        fitting = next((one for one in _encode(images) if sum(map(len, one[2])) <= max_bytes), None)
        if fitting is None:
            return None
        form, quality, data = fitting
        mapped = attach_maps(smooth, {"normalTexture": make_images(data, "normal", form)})
        sizes = tuple((image.shape[1], image.shape[0]) for image in images)
        return _Encoding(mapped, comparison.measure(mapped), data, sizes, form, quality)

    # Large parts of a bake are NumPy on one core. More than two bakes at a time would need too much memory.
    factors, threads = _list_factors(baker), min(get_worker_count(), 2)
    baked = map_ordered(bake, factors, threads=threads, max_pending=threads)
    best = min(filter(None, baked), key=lambda one: one.error.mean_deg, default=None)
    if best is None:
        return NormalMapResult(None, before, None)
    is_better = best.error.mean_deg < before.mean_deg
    return NormalMapResult(
        best.mesh if is_better else None,
        before,
        best.error,
        sum(map(len, best.data)),
        best.sizes,
        best.format,
        best.quality,
    )


def _list_factors(baker: DetailBaker) -> list[int]:
    """List the factors by which a map may be smaller than the images, without needlessly fine ones."""
    mesh = baker.original
    sides = mesh.vertices[mesh.triangles[:, 1]] - mesh.vertices[mesh.triangles[:, 0]]
    edge = float(np.linalg.norm(sides, axis=1).mean())
    texel_size = baker.pages.compute_median_texel_size()
    factors = [1 << k for k in range(baker.max_factor.bit_length())]
    needed = [factor for factor in factors if factor * texel_size >= _RESOLVED_EDGES * edge]
    return needed or factors[-1:]


def _encode(images: Sequence[NDArray[np.uint8]]) -> Iterator[tuple[str, int | None, list[bytes]]]:
    """Yield format, quality and files of images, best first."""
    yield "png", None, [encode_image(image, "png", 0) for image in images]
    for quality in _QUALITIES:
        yield "jpeg", quality, [encode_image(image, "jpeg", quality) for image in images]


def make_images(data: Sequence[bytes], name: str, form: str) -> list[Image]:
    """Make the images of a map from encoded files."""
    suffix = {"jpeg": "jpg"}.get(form, form)
    many = len(data) > 1
    return [
        Image(f"{name}{f'-{number}' if many else ''}.{suffix}", encoded=one)
        for number, one in enumerate(data, 1)
    ]


def attach_maps(mesh: Mesh, maps: Mapping[str, Sequence[Image]]) -> Mesh:
    """Add maps to the materials of a mesh.

    Parameters
    ----------
    mesh : textured mesh.
    maps : image of each material, by glTF texture name such as "normalTexture".
    """
    assert mesh.texture is not None
    materials = tuple(
        _attach_to_material(material, {name: images[number] for name, images in maps.items()})
        for number, material in enumerate(mesh.texture.materials)
    )
    return mesh.with_(texture=replace(mesh.texture, materials=materials))


def _attach_to_material(material: Material, images: Mapping[str, Image]) -> Material:
    kept = material.kept if isinstance(material.kept, GltfMaterialSource) else make_lit_source()
    tree, textures = copy.deepcopy(kept.tree), dict(kept.textures)
    for name, image in images.items():
        index = max(textures, default=-1) + 1
        textures[index] = (image, dict(CLAMP_SAMPLER))
        tree[name] = {"index": index}
    return replace(material, kept=replace(kept, tree=tree, textures=textures))
