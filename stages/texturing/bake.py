"""Bake the colours and details of an original surface onto its simplified mesh.

Each texel is mapped to its point on the simplified mesh. The texel takes the colour of the nearest point of
the original that faces the same way (Cignoni, Montani, Rocchini and Scopigno 1998, "A general method for
preserving attribute values on simplified meshes"). Gaps between charts are filled with colours of the charts
around them, so bilinear sampling and mip levels do not bleed foreign colours.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.compare import ColorError, CompareParams, compare_surfaces
from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.files.image_bytes import encode_gray_png, encode_png
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.formats.gltf_materials import is_unlit, make_unlit_source
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, compute_bounding_box
from scanloom.stages.surface.surface_color import has_color, is_transparent
from scanloom.stages.surface.texture import Image, Material, Texture, compute_signed_areas
from scanloom.stages.surface.topology import compute_areas, require_area
from scanloom.stages.texturing.atlas_layout import AtlasLayout, lay_out_smallest
from scanloom.stages.texturing.atlas_painting import paint_pages
from scanloom.stages.texturing.codes import TEXTURE_ATLAS_TOO_SMALL, TEXTURE_BAKE_LEFT_OUT
from scanloom.stages.texturing.color_lookup import ColorLookup
from scanloom.stages.texturing.detail_maps import DetailBaker, encode_displacements
from scanloom.stages.texturing.detail_size import SAMPLES_PER_DETAIL, estimate_mesh_detail
from scanloom.stages.texturing.normal_map import attach_maps, make_images
from scanloom.stages.texturing.shading_error import ShadingComparison, ShadingError
from scanloom.stages.texturing.shading_normals import add_shading_normals
from scanloom.stages.texturing.source_downscaling import downscale_images

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import BakeKeywords

RESULT_VERSION = 8

_MIN_SIZE = 64
# Typical ratio of an image that charts fill; converts `max_texels` to texels of surface.
_TYPICAL_FILL_RATIO = 0.5
# Minimum side of an image in multiples of the padding; smaller images have no space for a chart.
_MIN_SIDE_PER_PADDING = 4
_MAX_SAMPLES = 4
# Default limit of samples in all texels together. Finer source images are averaged before sampling instead,
# which is much faster and gives the same result.
_MAX_TOTAL_SAMPLES = 16e6
# Source images up to this factor finer than the target are sampled as they are.
_SIMILAR_RESOLUTION = 1.25
# Maximum area of the simplified mesh relative to the original. A larger mesh is of another surface, and its
# area does not increase the number of texels.
_MAX_AREA_RATIO = 4
_COMPARED_SAMPLES = 100_000
_DISPLACEMENT = "displacement"


@dataclass(frozen=True, kw_only=True)
class BakeParams:
    """Parameters of baking: maps, texel size, image size and sampling."""

    normal_map: bool = param(
        True,
        "Bake the shading normals of the original into a tangent-space normal map (glTF: MikkTSpace, green "
        "up).",
    )
    occlusion_map: bool = param(
        True, "Bake ambient occlusion, cast from the original with 256 rays per block of 4 × 4 texels."
    )
    occlusion_distance: float | None = param(
        None,
        "Surface beyond this distance does not occlude. Default: a tenth of the diagonal of the original's "
        "bounding box.",
        unit="m",
        low=0,
        low_open=True,
    )
    displacement_map: bool = param(
        False,
        "Bake the height of the original over the mesh into a 16-bit PNG file; 32768 is no displacement.",
    )

    texel_size: float | None = param(
        None,
        "Maximum size of a texel on the surface; the smallest sufficient image is used and filled. Default: "
        "0.4 of the original's mean edge length, or the size of its own texels.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_size: int = param(
        4096,
        "Longest side of an image; a power of two. Several images are written if one is not enough.",
        unit="texels",
        low=_MIN_SIZE,
        high=8192,
    )
    max_texels: float = param(
        16.0,
        "Approximate limit of all images together; texels get larger if more would be needed.",
        unit="million texels",
        low=0.01,
        high=1000,
    )
    padding: int | None = param(
        None,
        "Texels around each chart that continue its colours; the gap between two charts is twice as wide. "
        "8 texels keep two mip levels free of colour bleeding. At most a quarter of max_size. Default: 1/256 "
        "of the side, or 2 if that takes too much space.",
        unit="texels",
        low=1,
        high=128,
    )
    samples: int | None = param(
        None,
        "Samples along each side of a texel, which are averaged. Default: 1 to 4, enough to capture all "
        "detail of the original.",
        low=1,
        high=8,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.max_size & (self.max_size - 1):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {max_size} texels; it must be a power of two.",
                DiagnosticLocation(parameter="max_size"),
                max_size=self.max_size,
            )
        if _MIN_SIDE_PER_PADDING * (self.padding or 0) > self.max_size:
            raise UsageError(
                TEXTURE_ATLAS_TOO_SMALL,
                "is {padding} texels; it must be at most a quarter of max_size ({max_size} texels).",
                DiagnosticLocation(parameter="padding"),
                padding=self.padding,
                max_size=self.max_size,
            )


@dataclass(frozen=True, eq=False)
class BakeResult:
    """Textured mesh and its deviation from the original.

    Attributes
    ----------
    mesh : the simplified mesh with texture images, without vertex colours.
    sizes : (width, height) of each image, texels.
    texel_size : mean size of a texel on the surface, metres.
    coverage : ratio of the images that shows the surface.
    charts : number of charts.
    padding : minimum number of texels around each chart that continue its colours.
    samples : samples along each side of a texel.
    turned_ratio : ratio of samples whose nearest point faced away and was replaced by a point that faces the
        same
        way.
    color : colour difference from the original, sampled on the original; None if the original has no
        colours.
    vertex_color : the same for the vertex colours of the simplified mesh; None without vertex colours.
    image_bytes, source_image_bytes : file sizes of the new images, and of the images they replace; None if no
        image was replaced.
    resolution_scale : scale of an image side; below 1 if images were reduced to fit into the byte limit.
    quality : lowest JPEG or WebP quality of all images; None for PNG.
    shading_before, shading_after : angle between the shading normals of the mesh and the original, without
        normals and map, and with both; None without a normal map.
    maps : PNG files of the normal, occlusion and displacement maps, one per image, by name of the map.
    displacement_range : displacement that 32767 steps of the displacement map stand for, metres; None without
        one.
    diagnostics : warnings, such as attributes that baking drops.
    """

    mesh: Mesh
    sizes: tuple[tuple[int, int], ...]
    texel_size: float
    coverage: float
    charts: int
    padding: int
    samples: int
    turned_ratio: float
    color: ColorError | None
    vertex_color: ColorError | None
    image_bytes: int | None = None
    source_image_bytes: int | None = None
    resolution_scale: float = 1.0
    quality: int | None = None
    shading_before: ShadingError | None = None
    shading_after: ShadingError | None = None
    maps: Mapping[str, tuple[bytes, ...]] = field(default_factory=dict)
    displacement_range: float | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def mip_levels(self) -> int:
        """Number of mip levels without colour bleeding between charts."""
        # A bilinear sample reaches two texels of the halved image across.
        return max(int(math.log2(self.padding)) - 1, 0)

    def to_dict(self) -> dict[str, Any]:
        """Return all metrics for JSON, with units in the keys."""
        return {
            "triangles": len(self.mesh.triangles),
            "images": [list(size) for size in self.sizes],
            "texel_size_m": self.texel_size,
            "texels_per_m": 1 / self.texel_size,
            "coverage": self.coverage,
            "charts": self.charts,
            "padding_texels": self.padding,
            "mip_levels": self.mip_levels,
            "samples_per_texel": self.samples**2,
            "turned_sample_ratio": self.turned_ratio,
            "color": self.color and self.color.to_dict(),
            "vertex_color": self.vertex_color and self.vertex_color.to_dict(),
            "maps": {name: sum(map(len, files)) for name, files in self.maps.items()},
            "shading_error_before": self.shading_before and self.shading_before.to_dict(),
            "shading_error_after": self.shading_after and self.shading_after.to_dict(),
            "displacement_range_m": self.displacement_range,
            **self._collect_file_metrics(),
        }

    def list_map_files(self, stem: str, suffix: str) -> dict[str, bytes]:
        """Return the maps that a mesh file cannot hold, by file name.

        Parameters
        ----------
        stem : start of the file names.
        suffix : extension of the mesh file; glTF holds all maps except displacements.
        """
        is_gltf = suffix.lower() in (".glb", ".gltf")
        return {
            f"{stem}-{name}{f'-{number}' if len(files) > 1 else ''}.png": data
            for name, files in self.maps.items()
            if not is_gltf or name == _DISPLACEMENT
            for number, data in enumerate(files, 1)
        }

    def _collect_file_metrics(self) -> dict[str, Any]:
        if self.image_bytes is None:
            return {}
        return {
            "image_bytes": self.image_bytes,
            "source_image_bytes": self.source_image_bytes,
            "resolution_scale": self.resolution_scale,
            "quality": self.quality,
        }


def bake(
    simplified: MeshLike,
    original: MeshLike,
    params: BakeParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[BakeKeywords],
) -> BakeResult:
    """Bake the colours and details of an original mesh onto its simplified mesh.

    The result is deterministic. Memory besides the meshes and the images is bounded.

    Parameters
    ----------
    simplified : the simplified mesh: Mesh, Open3D or trimesh mesh, or a pair of arrays; need not be manifold.
        Its
        colours and texture are replaced.
    original : mesh in the same coordinates, usually with vertex colours or a texture.
    params : see BakeParams; single parameters can be given by keyword.
    progress : called with the number of finished rows of the images and their total.

    Returns
    -------
    Baked : the textured mesh with normals and maps, and its colour difference from the original.

    Raises
    ------
    MeshError
        If a mesh is invalid or has no area, the simplified mesh consists of degenerate triangles only, or the
        original has no colours and no map is requested.
    """
    params = resolve(BakeParams, params, changes)
    with collecting() as diagnostics:
        baked = _bake_mesh(simplified, original, params, progress)
    return replace(baked, diagnostics=tuple(diagnostics))


def _bake_mesh(
    simplified: MeshLike, original: MeshLike, params: BakeParams, progress: Progress
) -> BakeResult:
    target, reference = as_mesh(simplified, "simplified mesh"), as_mesh(original, "original")
    require_area(target, "simplified mesh")
    require_area(reference, "original")
    is_colored = has_color(reference)
    if not is_colored and not (params.normal_map or params.occlusion_map or params.displacement_map):
        raise MeshError(
            TEXTURE_BAKE_LEFT_OUT,
            "has neither vertex colours nor a texture, and no map is requested; there is nothing to bake.",
            "original",
        )
    stretch = _compute_detail_scale(target, reference)
    max_surface_texels = params.max_texels * 1e6 * _TYPICAL_FILL_RATIO
    min_texel_size = max(params.texel_size or 0.0, math.sqrt(_compute_area(target) / max_surface_texels))
    max_source_ratio = max(
        _limit_samples(_compute_area(target) / min_texel_size**2) / SAMPLES_PER_DETAIL, _SIMILAR_RESOLUTION
    )
    source = downscale_images(reference, min_texel_size / stretch, max_source_ratio)
    detail = estimate_mesh_detail(source) * stretch
    pages = lay_out_smallest(
        target,
        params.texel_size or detail,
        max_side=params.max_size,
        max_texels=max_surface_texels,
        padding=params.padding,
        progress=lambda *_: progress(0, 1),
    )
    texel_size = pages.compute_mean_texel_size(target)
    needed_samples = math.ceil(SAMPLES_PER_DETAIL * texel_size / detail)
    samples = params.samples or min(needed_samples, _limit_samples(_compute_area(target) / texel_size**2))
    box = compute_bounding_box(target, reference)
    surface = RaycastingSurface(reference, box)
    painted = None
    if is_colored:
        colors_of = ColorLookup(
            surface if source is reference else RaycastingSurface(source, box), target, texel_size
        )
        painted = paint_pages(target, pages, samples, colors_of, progress=progress)
    mesh = _attach_texture(target, pages, None if painted is None else painted.images, reference)
    details = _bake_details(mesh, reference, pages, params)
    if is_transparent(reference):
        emit(TEXTURE_BAKE_LEFT_OUT.warning("bake drops the transparency of the original's images."))
    if source is not reference:
        sizes = ", ".join(f"{width} × {height}" for width, height in pages.sizes)
        emit(
            TEXTURE_BAKE_LEFT_OUT.warning(
                "images of {sizes} texels cannot show all detail of the original's images; finer detail is "
                "averaged.",
                remedy="Larger values of max_texels and max_size keep more.",
                sizes=sizes,
            )
        )
    error = vertex_error = None
    if is_colored:
        error, vertex_error = (_compute_color_error(surface, one, box) for one in (mesh, target))
    return BakeResult(
        mesh=details.mesh,
        sizes=pages.sizes,
        texel_size=texel_size,
        coverage=float(np.abs(compute_signed_areas(pages.corners)).sum()) / sum(w * h for w, h in pages.sizes)
        if painted is None
        else painted.coverage,
        charts=int(pages.charts.max()) + 1,
        padding=pages.padding,
        samples=samples,
        turned_ratio=0.0 if painted is None else painted.turned_ratio,
        color=error,
        vertex_color=vertex_error if target.colors is not None else None,
        shading_before=details.shading_before,
        shading_after=details.shading_after,
        maps=details.maps,
        displacement_range=details.displacement_range,
    )


@dataclass(frozen=True, eq=False)
class _Details:
    """Mesh with detail maps; see `BakeResult`."""

    mesh: Mesh
    maps: Mapping[str, tuple[bytes, ...]] = field(default_factory=dict)
    shading_before: ShadingError | None = None
    shading_after: ShadingError | None = None
    displacement_range: float | None = None


def _bake_details(mesh: Mesh, original: Mesh, pages: AtlasLayout, params: BakeParams) -> _Details:
    """Bake the requested maps and add them to the materials."""
    if not (params.normal_map or params.occlusion_map or params.displacement_map):
        return _Details(mesh)
    shaded = add_shading_normals(mesh, pages.uvs)
    baker = DetailBaker(shaded, original, pages)
    maps: dict[str, tuple[bytes, ...]] = {}
    attached: dict[str, list[Image]] = {}
    displacement_range = before = after = None
    if params.normal_map:
        maps["normal"] = tuple(map(encode_png, baker.bake_normals()))
        attached["normalTexture"] = make_images(maps["normal"], "normal", "png")
    if params.displacement_map:
        steps, displacement_range = encode_displacements(baker.bake_displacements())
        maps[_DISPLACEMENT] = tuple(map(encode_gray_png, steps))
    if params.occlusion_map:
        shades = baker.bake_occlusion(params.occlusion_distance)
        maps["occlusion"] = tuple(encode_gray_png(np.ascontiguousarray(one[:, :, 0])) for one in shades)
        attached["occlusionTexture"] = make_images(maps["occlusion"], "occlusion", "png")
    result = attach_maps(shaded, attached)
    if params.normal_map:
        comparison = ShadingComparison(mesh, original, baker.original_normals)
        before, after = comparison.measure(mesh), comparison.measure(result)
    return _Details(result, maps, before, after, displacement_range)


def _attach_texture(
    mesh: Mesh, pages: AtlasLayout, images: Sequence[NDArray[np.uint8]] | None, original: Mesh
) -> Mesh:
    """Attach the images to a mesh and remove its vertex colours.

    Vertex colours are removed because viewers multiply them with the texture. The material is unlit if all
    materials of the original are.
    """
    count = len(pages.sizes)
    names = [f"baked-{number}" for number in range(1, count + 1)] if count > 1 else ["baked"]
    original_materials = () if original.texture is None else original.texture.materials
    kept = make_unlit_source() if original_materials and all(map(is_unlit, original_materials)) else None
    materials = tuple(
        Material(
            name,
            None if images is None else Image(f"{name}.png", given=images[number]),
            wrap=("clamp", "clamp"),
            kept=kept,
        )
        for number, name in enumerate(names)
    )
    return mesh.with_(colors=None, texture=Texture(pages.uvs, pages.images, materials))


def _compute_detail_scale(simplified: Mesh, original: Mesh) -> float:
    """Return the scale of details on the simplified mesh relative to the original.

    The scale is 1 unless the simplified mesh has more than `_MAX_AREA_RATIO` times the area.
    """
    light_area, area = (
        float(compute_areas(mesh.vertices, mesh.triangles).sum()) for mesh in (simplified, original)
    )
    return math.sqrt(light_area / area) if light_area > _MAX_AREA_RATIO * area else 1.0


def _limit_samples(texels: float) -> int:
    """Return the affordable samples along a texel's side."""
    return max(min(int(math.sqrt(_MAX_TOTAL_SAMPLES / texels)), _MAX_SAMPLES), 1)


def _compute_area(mesh: Mesh) -> float:
    return float(compute_areas(mesh.vertices, mesh.triangles).sum())


def _compute_color_error(original: RaycastingSurface, mesh: Mesh, box: Floats) -> ColorError | None:
    return compare_surfaces(
        original, RaycastingSurface(mesh, box), CompareParams(samples=_COMPARED_SAMPLES)
    ).color_a_to_b
