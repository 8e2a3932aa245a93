"""Baker for the images of one material class."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.color_conversion import convert_linear_to_srgb, convert_srgb_to_linear
from scanloom.stages.surface.formats.gltf_materials import multiplies_colors
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import compute_surface_colors
from scanloom.stages.surface.texture import Image, Material, compute_signed_areas
from scanloom.stages.texturing.atlas_layout import AtlasLayout
from scanloom.stages.texturing.baked_material import build_material
from scanloom.stages.texturing.correspondence import Correspondence, TexelPoints
from scanloom.stages.texturing.gap_filling import fill_gaps_with_block_means
from scanloom.stages.texturing.image_format import ImageFormat, choose_format, resize_image
from scanloom.stages.texturing.material_classes import (
    BASE_COLOR,
    FACTORS,
    MaterialClass,
    TexturePath,
    get_image,
    get_value,
    get_wrap,
    is_opaque,
    list_images,
)
from scanloom.stages.texturing.material_factors import (
    apply_factors,
    apply_tint,
    has_common_base_color,
    has_common_factors,
)
from scanloom.stages.texturing.tangent_frames import (
    TangentFrames,
    compute_tangent_frames,
    decode_normals,
    encode_normals,
)
from scanloom.stages.texturing.texel_budgets import TexelBudget

Pixels = NDArray[np.uint8]

# Source images finer than the atlas by more than this factor are averaged before sampling, to avoid aliasing.
_SIMILAR_RESOLUTION = 1.25
_WHITE = 255
_FLAT_NORMAL = (128, 128, 255)
# Normals transformed per batch: bounds memory.
_BATCH_TEXELS = 1 << 18
_SRGB_LEVELS = np.arange(256) / 255


@dataclass(frozen=True, eq=False)
class ClassMeshes:
    """Triangles of one class, in both meshes.

    Attributes
    ----------
    simplified, original : triangles of the class, with the vertices that they use.
    rows : (q,) indices of the triangles in the whole simplified mesh.
    """

    simplified: Mesh
    original: Mesh
    rows: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class MaterialDraft:
    """Material whose images are not encoded yet.

    Attributes
    ----------
    canvases : name, pixels and format of each image.
    image_indices : index into `canvases` for each texture path.
    build : function that builds the material from the image of each texture path.
    """

    canvases: list[tuple[str, Pixels, ImageFormat]]
    image_indices: dict[TexturePath, int]
    build: Callable[[dict[TexturePath, Image]], Material]


@dataclass(eq=False)
class AtlasStats:
    """Statistics of the atlases of all classes.

    Attributes
    ----------
    texels, surface_texels : texels of all images, and texels that show the surface.
    turned_texels : texels whose nearest source point faced away and was replaced.
    charts : number of charts.
    padding : minimum padding of all atlases, texels.
    """

    texels: int = 0
    surface_texels: int = 0
    turned_texels: int = 0
    charts: int = 0
    padding: float = math.inf


class ClassBaker:
    """Baker for the images of one material class, page by page of its atlas."""

    def __init__(
        self,
        part: ClassMeshes,
        material_class: MaterialClass,
        budget: TexelBudget,
        pages: AtlasLayout,
        covered: float,
    ) -> None:
        self._part, self._class, self._budget, self._pages = part, material_class, budget, pages
        texture = part.original.texture
        assert texture is not None
        self._texture = texture
        self._has_uvs = texture.has_uvs()
        self._uv_areas = np.abs(compute_signed_areas(texture.uvs))
        self._atlas_texels = float(np.abs(compute_signed_areas(pages.corners)).sum())
        self._covered = covered
        self._reduced: dict[tuple[int, int], Pixels] = {}
        self._frames: tuple[TangentFrames, TangentFrames] | None = None

    def bake_page(
        self, correspondence: Correspondence, page: int, name: str, stats: AtlasStats
    ) -> MaterialDraft:
        """Bake the images of one page of the atlas, and update the statistics."""
        sources = correspondence.find_sources(page)
        self._correspondence, self._page = correspondence, page
        width, height = self._pages.sizes[page]
        filled = sources.is_filled
        self._sources = sources
        stats.texels += width * height
        stats.surface_texels += int(np.count_nonzero(filled))
        stats.turned_texels += sources.turned_count
        jobs: list[tuple[Any, TexturePath]] = []
        canvases = []
        base = self._bake_base_color()
        if base is not None:
            jobs.append((BASE_COLOR, BASE_COLOR))
            canvases.append(base)
        for path in self._class.maps:
            if not list_images(self._texture, self._class, path):
                continue
            key = self._make_map_key(path)
            if all(key != other for other, _ in jobs):
                jobs.append((key, path))
                canvases.append(self._bake_map(path))
        fill_gaps_with_block_means(canvases, filled)
        index_of = {key: index for index, (key, _) in enumerate(jobs)}
        image_indices = {}
        for path in (BASE_COLOR, *self._class.maps):
            key = BASE_COLOR if path == BASE_COLOR else self._make_map_key(path)
            if key in index_of:
                image_indices[path] = index_of[key]
        return MaterialDraft(
            [
                self._prepare_image(path, canvas, name)
                for (_, path), canvas in zip(jobs, canvases, strict=True)
            ],
            image_indices,
            partial(build_material, self._texture, self._class),
        )

    def _load_map(self, number: int, path: TexturePath, channels: int) -> Pixels | None:
        """Load a map at no more than the resolution of the atlas."""
        image = get_image(self._texture.materials[number], path) if number >= 0 else None
        if image is None:
            return None
        key = (id(image), channels)
        if key not in self._reduced:
            pixels = image.pixels
            if pixels.shape[2] == 3 and channels == 4:
                pixels = np.concatenate([pixels, np.full((*pixels.shape[:2], 1), 255, np.uint8)], axis=2)
            pixels = np.ascontiguousarray(pixels[..., :channels])
            height, width = pixels.shape[:2]
            is_selected = self._texture.material_ids == number
            scale = math.sqrt(
                float(self._uv_areas[is_selected].sum())
                * width
                * height
                / self._count_atlas_texels(is_selected)
            )
            if scale > _SIMILAR_RESOLUTION:
                pixels = resize_image(pixels, (max(round(width / scale), 1), max(round(height / scale), 1)))
            self._reduced[key] = pixels
        return self._reduced[key]

    def _count_atlas_texels(self, is_selected: NDArray[np.bool_]) -> float:
        """Estimate the number of atlas texels of some original triangles."""
        shown = float(self._budget.covered[is_selected].sum())
        return max(self._atlas_texels * shown / max(self._covered, 1e-300), 1e-300)

    def _sample(self, canvas: Pixels, image: Pixels, number: int, path: TexturePath) -> None:
        """Sample an image into the texels of a canvas that show a material."""
        is_shown = self._texture.material_ids == number
        self._sources.sample(
            canvas, image, self._texture.uvs, is_shown, get_wrap(self._texture.materials[number], path)
        )

    def _create_canvas(self, color: Sequence[int]) -> Pixels:
        width, height = self._pages.sizes[self._page]
        if len(set(color)) == 1:
            # `np.full` with a scalar is much faster than broadcasting a colour.
            return np.full((height, width, len(color)), color[0], np.uint8)
        canvas = np.empty((height, width, len(color)), np.uint8)
        canvas[:] = color
        return canvas

    def _find_points(self, is_shown: NDArray[np.bool_]) -> TexelPoints:
        """Select the source points on the given original triangles (m,)."""
        points = self._sources.points
        return points if is_shown.all() else points[is_shown[points.triangles]]

    def _bake_base_color(self) -> Pixels | None:
        """Bake the base colours (h, w, 3 or 4); None if the class has none."""
        mesh, one = self._part.original, self._class
        images = list_images(self._texture, one, BASE_COLOR)
        if not images and mesh.colors is None:
            return None
        channels = 4 if self.has_alpha() else 3
        canvas = self._create_canvas((_WHITE,) * channels)
        texels = canvas.reshape(-1, channels)
        has_image = np.zeros(len(mesh.triangles), bool)
        for number in one.material_indices:
            image = self._load_map(number, BASE_COLOR, channels)
            if image is None:
                continue
            is_its = self._texture.material_ids == number
            has_image |= is_its
            material = self._texture.materials[number]
            if material.base_color is not None and not has_common_base_color(self._texture, self._class):
                image = apply_tint(image, material.base_color)
            self._sample(canvas, image, number, BASE_COLOR)
            if mesh.colors is not None and multiplies_colors(material):
                points = self._find_points(is_its)
                texels[points.texels, :3] = self._multiply_colors(texels[points.texels, :3], points)
        is_bare = ~(has_image & self._has_uvs)
        if is_bare.any():
            points = self._find_points(is_bare)
            texels[points.texels, :3] = self._sample_colors(points)
        return canvas

    def has_alpha(self) -> bool:
        """Check for visible transparency in the images of the class."""
        for number in self._class.material_indices:
            image = get_image(self._texture.materials[number], BASE_COLOR) if number >= 0 else None
            if image is None or image.pixels.shape[2] < 4 or is_opaque(self._texture.materials[number]):
                continue
            if image.pixels[..., 3].min() < 255:
                return True
        return False

    def _sample_colors(self, points: TexelPoints) -> Pixels:
        found = compute_surface_colors(self._part.original, points.triangles, points.weights)
        return np.rint(found).clip(0, 255).astype(np.uint8)

    def _multiply_colors(self, sampled: Pixels, points: TexelPoints) -> Pixels:
        bare = self._part.original.with_(texture=None)
        colors = compute_surface_colors(bare, points.triangles, points.weights)
        light = convert_srgb_to_linear(_SRGB_LEVELS)[sampled] * convert_srgb_to_linear(colors / 255)
        return np.rint(255 * convert_linear_to_srgb(light)).clip(0, 255).astype(np.uint8)

    def _bake_map(self, path: TexturePath) -> Pixels:
        """Bake a map other than the base colour, (h, w, 3)."""
        is_normal = path[-1].lower().endswith("normaltexture")
        canvas = self._create_canvas(_FLAT_NORMAL if is_normal else (_WHITE,) * 3)
        for number in self._class.material_indices:
            image = self._load_map(number, path, 3)
            if image is not None:
                self._sample(
                    canvas,
                    image if is_normal else apply_factors(self._texture, self._class, image, number, path),
                    number,
                    path,
                )
        if is_normal:
            self._transform_normals(canvas, path)
        return canvas

    def _transform_normals(self, canvas: Pixels, path: TexturePath) -> None:
        """Transform normals from original to simplified tangent frames, in place."""
        if self._frames is None:
            self._frames = (
                compute_tangent_frames(self._part.original, self._texture.uvs),
                compute_tangent_frames(self._part.simplified, self._pages.uvs),
            )
        old, new = self._frames
        # The last entry is for triangles without a material (index −1).
        scales = np.ones(len(self._texture.materials) + 1, np.float32)
        for number in self._class.material_indices:
            if number >= 0:
                scales[number] = float(
                    get_value(self._texture.materials[number].kept.tree, (*path, "scale"), 1.0)
                )
        points = self._sources.points
        texels = canvas.reshape(-1, 3)
        for start in range(0, len(points.texels), _BATCH_TEXELS):
            part = slice(start, start + _BATCH_TEXELS)
            at, triangles = points.texels[part], points.triangles[part]
            directions = decode_normals(
                texels[at],
                old.interpolate(triangles, points.weights[part]),
                scales[self._texture.material_ids[triangles]],
            )
            own = self._correspondence.locate_texels(self._page, at)
            texels[at] = encode_normals(directions, new.interpolate(own.triangles, own.weights))

    def _make_map_key(self, path: TexturePath) -> Any:
        """Return a cache key for a baked map.

        Maps with equal keys have equal images and are baked once.
        """
        is_normal = path[-1].lower().endswith("normaltexture")
        images = tuple(
            id(get_image(self._texture.materials[number], path)) for number in self._class.material_indices
        )
        is_own = is_normal or (path in FACTORS and not has_common_factors(self._texture, self._class, path))
        wraps = tuple(
            get_wrap(self._texture.materials[number], path) for number in self._class.material_indices
        )
        return (images, wraps, path if is_own else None)

    def _prepare_image(self, path: TexturePath, canvas: Pixels, name: str) -> tuple[str, Pixels, ImageFormat]:
        """Choose name, size and format of a baked image."""
        images = list_images(self._texture, self._class, path)
        is_color = path == BASE_COLOR or path[-1] == "emissiveTexture"
        every = images or [
            image for place in self._class.maps for image in list_images(self._texture, self._class, place)
        ]
        form = choose_format(every, has_alpha=canvas.shape[2] == 4, is_color=is_color)
        suffix = "" if path == BASE_COLOR else f"-{path[-1].removesuffix('Texture')}"
        canvas = self._limit_size(canvas, path) if images else canvas
        return f"{name}{suffix}.{form.extension}", canvas, form

    def _limit_size(self, canvas: Pixels, path: TexturePath) -> Pixels:
        """Halve an image until it is about as coarse as the images it replaces."""
        covered = 0.0
        for number in self._class.material_indices:
            image = get_image(self._texture.materials[number], path) if number >= 0 else None
            if image is not None:
                is_selected = self._texture.material_ids == number
                covered += (
                    float(self._uv_areas[is_selected].sum()) * image.pixels.shape[0] * image.pixels.shape[1]
                )
        while covered > 0 and covered < self._atlas_texels / 2 and min(canvas.shape[:2]) >= 64:
            canvas = resize_image(canvas, (canvas.shape[1] // 2, canvas.shape[0] // 2))
            covered *= 4
        return canvas
