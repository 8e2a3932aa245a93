"""Bake all images of a textured model anew for its simplified mesh.

Each class of materials gets an atlas of its own, of no more texels than the images that it replaces. The
point of the original that a texel shows is looked up once, and all maps of the class are sampled there: base
colour and alpha, normals in tangent space, and whatever else the materials name.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.asked import asked
from scanloom.stages.comparing.compare import sampled_color_error
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.color import color_at
from scanloom.stages.surface.formats.colors import linear_from_srgb, srgb_from_linear
from scanloom.stages.surface.formats.gltf_materials import GltfStatements, multiplies_colors
from scanloom.stages.surface.formats.mtl import MtlStatements
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import bounding_box
from scanloom.stages.surface.texture import Image, Material, Texture, signed_areas
from scanloom.stages.surface.topology import areas
from scanloom.stages.texturing.bake import Baked
from scanloom.stages.texturing.codes import SIMPLIFY_IMAGES_SMALLER, TEXTURE_BAKE_LEFT_OUT
from scanloom.stages.texturing.correspondence import Correspondence, TexelPoints, locate_vertices
from scanloom.stages.texturing.detail import details_of
from scanloom.stages.texturing.filling import fill_gaps
from scanloom.stages.texturing.image_format import (
    EncodedImage,
    ImageFormat,
    choose_format,
    encode_within,
    resize_image,
)
from scanloom.stages.texturing.material_classes import (
    BASE_COLOR,
    FACTORS,
    MaterialClass,
    Path,
    image_at,
    is_opaque,
    value_at,
)
from scanloom.stages.texturing.pages import Pages, lay_out_within
from scanloom.stages.texturing.tangent_frames import decode_normals, encode_normals, tangent_frames

Pixels = NDArray[np.uint8]

# Points of the original at which the colour error is measured.
_COMPARED = 30_000
# Bytes that a triangle takes at least in a file of any format: what is removed leaves as many for images, and
# the file is no larger than before.
_BYTES_PER_TRIANGLE = 12
# Texels of an atlas for each visible texel of the old images, as far as these have so many: an image that is
# sampled again loses detail. On four scans a quarter more is worth 0.2 to 1.7 dB.
_OVERSAMPLING = 1.25
# An image that is finer than its atlas by more than this factor is averaged first.
_SIMILAR = 1.25
# Least texels of an atlas: charts need some room.
_MIN_TEXELS = 64 * 64
# Ratio between the 90th and the 10th percentile of the density of texels over the surface, from which the
# atlas follows it.
_UNEVEN = 4.0
# Limits of the density of a triangle, relative to the mean.
_MIN_DENSITY, _MAX_DENSITY = 1 / 16, 4.0
_WHITE = 255
_FLAT_NORMAL = (128, 128, 255)
# Normals transformed at a time: bounds the memory.
_AT_ONCE = 1 << 18
_CLAMP = {"wrapS": 33071, "wrapT": 33071}
_SRGB_LEVELS = np.arange(256) / 255


@dataclass(frozen=True, eq=False)
class _Part:
    """Triangles of one class.

    Attributes
    ----------
    simplified, original : with the vertices that they use.
    rows : of the simplified mesh's triangles.
    """

    simplified: Mesh
    original: Mesh
    rows: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class _Budget:
    """Texels that the images of a class may have.

    Attributes
    ----------
    covered : (k,) texels of its finest images under each triangle of the original.
    texels : of all of these images; None where there are none.
    max_side : largest side of an image.
    """

    covered: NDArray[np.float64]
    texels: float | None
    max_side: int


@dataclass(frozen=True, eq=False)
class _Draft:
    """A material whose images are still to be encoded.

    Attributes
    ----------
    canvases : name, pixels and format of each image.
    places : of its textures, with the index of their image.
    describe : returns the material of these images.
    """

    canvases: list[tuple[str, Pixels, ImageFormat]]
    places: dict[Path, int]
    describe: Callable[[dict[Path, Image]], Material]


@dataclass(eq=False)
class _Totals:
    """Statistics of all images."""

    texels: int = 0
    shown: int = 0
    turned: int = 0
    charts: int = 0
    padding: float = math.inf


def bake_materials(
    simplified: Mesh,
    original: Mesh,
    class_ids: NDArray[np.int32],
    original_class_ids: NDArray[np.int32],
    classes: Sequence[MaterialClass],
    *,
    progress: Progress = silent,
) -> Baked:
    """Bake the images of a model anew for its simplified mesh.

    Parameters
    ----------
    simplified : its texture and colours are replaced.
    class_ids : (q,) of the triangles of the simplified mesh, into `classes`.
    original_class_ids : (m,) of those of the original.
    classes : of `material_classes`.

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
) -> Baked:
    assert original.texture is not None
    drafts: list[_Draft | Material] = []
    uvs = np.zeros((len(simplified.triangles), 3, 2))
    material_ids = np.full(len(simplified.triangles), -1, np.int32)
    totals = _Totals()
    budgets = _compute_budgets(original, original_class_ids, classes)
    for index, one in enumerate(classes):
        progress(index, len(classes))
        rows = np.flatnonzero(class_ids == index)
        own = np.flatnonzero(original_class_ids == index)
        if not len(rows) or not len(own):
            continue
        if not one.is_baked:
            if one.numbers[0] >= 0:
                material_ids[rows] = len(drafts)
                drafts.append(original.texture.materials[one.numbers[0]])
            continue
        part = _Part(_select_triangles(simplified, rows), _select_triangles(original, own), rows)
        many = sum(other.is_baked for other in classes) > 1
        name = f"baked-{index + 1}" if many else "baked"
        pages, found = _bake_class(part, one, budgets[index], name, totals)
        uvs[rows] = pages.uvs
        material_ids[rows] = len(drafts) + pages.images
        drafts += found
    sources = _list_all_images(original, classes)
    source_bytes = sum(len(image.file_bytes) for image in sources)
    removed = max(len(original.triangles) - len(simplified.triangles), 0)
    encoded, scale = encode_within(
        [
            (pixels, form)
            for draft in drafts
            if isinstance(draft, _Draft)
            for _, pixels, form in draft.canvases
        ],
        source_bytes + _BYTES_PER_TRIANGLE * removed,
    )
    materials = _attach_images(drafts, encoded)
    if scale < 1:
        emit(
            SIMPLIFY_IMAGES_SMALLER.warning(
                "baked images have {scale:.0%} of the resolution of the old ones along each side, so that "
                "the file is no larger than the input.",
                scale=scale,
            )
        )
    mesh = simplified.with_(
        colors=None,
        texture=Texture(uvs, material_ids, tuple(materials)),
    )
    box = bounding_box(original, mesh)
    color = sampled_color_error(asked(original, box), asked(mesh, box), _COMPARED)
    assert color is not None
    laid = np.abs(signed_areas(uvs * _get_image_sizes(mesh)))
    is_laid = laid > 0
    area = areas(mesh.vertices, mesh.triangles)
    return Baked(
        mesh=mesh,
        sizes=tuple(image.size for image in encoded),
        texel_size=math.sqrt(float(area[is_laid].sum()) / max(float(laid.sum()), 1e-300)),
        coverage=totals.shown / max(totals.texels, 1),
        charts=totals.charts,
        padding=int(totals.padding) if math.isfinite(totals.padding) else 0,
        samples=1,
        turned=totals.turned / max(totals.shown, 1),
        color=color,
        vertex_color=None,
        image_bytes=sum(len(image.data) for image in encoded),
        source_image_bytes=source_bytes,
        resolution_scale=scale,
        quality=min((image.quality for image in encoded if image.quality is not None), default=None),
    )


def _attach_images(drafts: Sequence[_Draft | Material], encoded: Sequence[EncodedImage]) -> list[Material]:
    """Create the materials from drafts and their encoded images, in the same order."""
    rest = iter(encoded)
    materials = []
    for draft in drafts:
        if isinstance(draft, Material):
            materials.append(draft)
            continue
        images = [Image(name=name, encoded=next(rest).data) for name, _, _ in draft.canvases]
        materials.append(draft.describe({path: images[index] for path, index in draft.places.items()}))
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


def _list_all_images(mesh: Mesh, classes: Sequence[MaterialClass]) -> list[Image]:
    """List the images that baking replaces, without repeats."""
    assert mesh.texture is not None
    found: dict[int, Image] = {}
    for one in classes:
        if one.is_baked:
            for path in (BASE_COLOR, *one.maps):
                found.update({id(image): image for image in _list_images(mesh.texture, one, path)})
    return list(found.values())


def _list_images(texture: Texture, one: MaterialClass, path: Path) -> list[Image]:
    """List the images of a class for one texture, without repeats."""
    found = [image_at(texture.materials[number], path) for number in one.numbers if number >= 0]
    return list({id(image): image for image in found if image is not None}.values())


def _compute_budgets(
    mesh: Mesh, class_ids: NDArray[np.int32], classes: Sequence[MaterialClass]
) -> list[_Budget]:
    """Compute the texel budget of each class; classes share an image by covered area."""
    texture = mesh.texture
    assert texture is not None
    spread = np.abs(signed_areas(texture.uvs))
    shares: dict[int, dict[int, float]] = {}
    images: dict[int, Image] = {}
    for index, one in enumerate(classes):
        for path in (BASE_COLOR, *one.maps):
            for number in one.numbers:
                image = image_at(texture.materials[number], path) if number >= 0 else None
                if image is not None:
                    images[id(image)] = image
                    shown = float(spread[(class_ids == index) & (texture.material_ids == number)].sum())
                    of_image = shares.setdefault(id(image), {})
                    of_image[index] = of_image.get(index, 0.0) + shown
    vertex_details = details_of(mesh) if mesh.colors is not None else None
    area = areas(mesh.vertices, mesh.triangles)
    budgets = []
    for index, one in enumerate(classes):
        rows = np.flatnonzero(class_ids == index)
        covered, texels, max_side = np.zeros(len(rows)), 0.0, 64
        for path in (BASE_COLOR, *one.maps):
            total, under = 0.0, np.zeros(len(rows))
            for number in one.numbers:
                image = image_at(texture.materials[number], path) if number >= 0 else None
                if image is not None:
                    height, width = image.pixels.shape[:2]
                    its = texture.material_ids[rows] == number
                    under[its] = spread[rows[its]] * width * height
                    max_side = max(max_side, width, height)
            for image in _list_images(texture, one, path):
                of_image = shares[id(image)]
                share = of_image.get(index, 0.0) / max(sum(of_image.values()), 1e-300)
                total += share * image.pixels.shape[0] * image.pixels.shape[1]
            if under.sum() > covered.sum():
                covered, texels = under, total
        if not covered.any() and vertex_details is not None:
            with np.errstate(divide="ignore"):
                covered = np.where(
                    np.isfinite(vertex_details[rows]), area[rows] / vertex_details[rows] ** 2, 0.0
                )
            budgets.append(_Budget(covered, None, 4096))
            continue
        budgets.append(_Budget(covered, texels, max_side))
    return budgets


def _bake_class(
    part: _Part, one: MaterialClass, budget: _Budget, name: str, totals: _Totals
) -> tuple[Pages, list[_Draft]]:
    total = float(budget.covered.sum())
    limit = None if budget.texels is None else max(budget.texels, _MIN_TEXELS)
    vertices = locate_vertices(part.simplified, part.original)
    nearest = vertices.located.triangles[part.original.triangles]
    densities = _compute_densities(part.simplified, part.original, nearest, budget.covered)
    pages = lay_out_within(
        part.simplified,
        densities,
        texels=max(_OVERSAMPLING * total, 1.0),
        max_texels=limit,
        max_side=min(1 << max(budget.max_side - 1, 1).bit_length(), 8192),
    )
    correspondence = Correspondence(part.simplified, part.original, pages, vertices)
    totals.charts += int(pages.charts.max()) + 1
    totals.padding = min(totals.padding, pages.padding)
    baker = _ClassBaker(part, one, budget, pages, total)
    found = []
    for page in range(len(pages.sizes)):
        label = f"{name}-{page + 1}" if len(pages.sizes) > 1 else name
        found.append(baker.bake_page(correspondence, page, label, totals))
    return pages, found


def _compute_densities(
    mesh: Mesh, original: Mesh, nearest: NDArray[np.int64], covered: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the relative texel density of each triangle of the simplified mesh.

    The density is even unless that of the original varies strongly over its surface.

    Parameters
    ----------
    mesh : the simplified mesh.
    nearest : (m, 3) triangles of the simplified mesh under the corners of the original.
    covered : texels of each triangle of the original.
    """
    even = np.ones(len(mesh.triangles))
    area = areas(original.vertices, original.triangles)
    density = np.sqrt(np.divide(covered, area, out=np.zeros_like(area), where=area > 0))
    order = np.argsort(density, kind="stable")
    before = np.cumsum(area[order])
    low, high = (density[order][np.searchsorted(before, share * before[-1])] for share in (0.1, 0.9))
    if high <= _UNEVEN * low:
        return even
    count = len(mesh.triangles)
    texels, beneath = (
        np.bincount(nearest.reshape(-1), np.repeat(values, 3), minlength=count) for values in (covered, area)
    )
    corners = mesh.triangles.reshape(-1)
    for _ in range(2):
        # Spread over neighbours: small triangles of the simplified mesh have hardly any of the original.
        texels, beneath = (
            np.bincount(corners, np.repeat(values, 3), minlength=len(mesh.vertices))[mesh.triangles].mean(
                axis=1
            )
            for values in (texels, beneath)
        )
    wanted = np.sqrt(texels / np.maximum(beneath, 1e-300))
    own = areas(mesh.vertices, mesh.triangles)
    mean = math.sqrt(float((wanted**2 * own).sum() / own.sum()))
    if mean == 0:
        return even
    # By powers of two: a chart ends where the density changes.
    return np.asarray(2.0 ** np.round(np.log2((wanted / mean).clip(_MIN_DENSITY, _MAX_DENSITY))))


class _ClassBaker:
    """Baker of the maps of one class of materials."""

    def __init__(
        self, part: _Part, one: MaterialClass, budget: _Budget, pages: Pages, covered: float
    ) -> None:
        self._part, self._class, self._budget, self._pages = part, one, budget, pages
        texture = part.original.texture
        assert texture is not None
        self._texture = texture
        self._has_uvs = texture.has_uvs()
        self._spread = np.abs(signed_areas(texture.uvs))
        self._laid = float(np.abs(signed_areas(pages.corners)).sum())
        self._covered = covered
        self._reduced: dict[tuple[int, int], Pixels] = {}
        self._frames: Any = None

    def bake_page(self, correspondence: Correspondence, page: int, name: str, totals: _Totals) -> _Draft:
        """Bake the images of one page of the atlas."""
        sources = correspondence.find_sources(page)
        self._correspondence, self._page = correspondence, page
        width, height = self._pages.sizes[page]
        filled = sources.is_filled
        self._sources = sources
        totals.texels += width * height
        totals.shown += int(np.count_nonzero(filled))
        totals.turned += sources.turned_count
        first = self._first_material()
        jobs: list[tuple[Any, Path]] = []
        canvases = []
        base = self._bake_base_color()
        if base is not None:
            jobs.append((BASE_COLOR, BASE_COLOR))
            canvases.append(base)
        for path in self._class.maps:
            if not _list_images(self._texture, self._class, path):
                continue
            key = self._map_key(path)
            if all(key != other for other, _ in jobs):
                jobs.append((key, path))
                canvases.append(self._bake_map(path))
        fill_gaps(canvases, filled)
        index_of = {key: index for index, (key, _) in enumerate(jobs)}
        places = {}
        for path in (BASE_COLOR, *self._class.maps):
            key = BASE_COLOR if path == BASE_COLOR else self._map_key(path)
            if key in index_of:
                places[path] = index_of[key]
        return _Draft(
            [
                self._prepare_image(path, canvas, name)
                for (_, path), canvas in zip(jobs, canvases, strict=True)
            ],
            places,
            lambda images: self._build_material(first, images),
        )

    def _first_material(self) -> Material:
        number = self._class.numbers[0]
        return self._texture.materials[number] if number >= 0 else Material()

    def _load_map(self, number: int, path: Path, channels: int) -> Pixels | None:
        """Load a map, averaged to the resolution of the atlas if it is finer."""
        image = image_at(self._texture.materials[number], path) if number >= 0 else None
        if image is None:
            return None
        key = (id(image), channels)
        if key not in self._reduced:
            pixels = image.pixels
            if pixels.shape[2] == 3 and channels == 4:
                pixels = np.concatenate([pixels, np.full((*pixels.shape[:2], 1), 255, np.uint8)], axis=2)
            pixels = np.ascontiguousarray(pixels[..., :channels])
            height, width = pixels.shape[:2]
            its = self._texture.material_ids == number
            finer = math.sqrt(float(self._spread[its].sum()) * width * height / self._count_atlas_texels(its))
            if finer > _SIMILAR:
                pixels = resize_image(pixels, (max(round(width / finer), 1), max(round(height / finer), 1)))
            self._reduced[key] = pixels
        return self._reduced[key]

    def _count_atlas_texels(self, its: NDArray[np.bool_]) -> float:
        """Estimate how many texels of the atlas show some triangles of the original."""
        shown = float(self._budget.covered[its].sum())
        return max(self._laid * shown / max(self._covered, 1e-300), 1e-300)

    def _sample(self, canvas: Pixels, image: Pixels, number: int, path: Path) -> None:
        """Sample an image into the texels of a canvas that show a material."""
        is_shown = self._texture.material_ids == number
        self._sources.sample(canvas, image, self._texture.uvs, is_shown, self._get_wrap(number, path))

    def _create_canvas(self, color: Sequence[int]) -> Pixels:
        width, height = self._pages.sizes[self._page]
        if len(set(color)) == 1:
            # Much faster than a pattern.
            return np.full((height, width, len(color)), color[0], np.uint8)
        canvas = np.empty((height, width, len(color)), np.uint8)
        canvas[:] = color
        return canvas

    def _get_wrap(self, number: int, path: Path) -> tuple[str, str]:
        material = self._texture.materials[number]
        if path == BASE_COLOR:
            return material.wrap
        codes = {10497: "repeat", 33071: "clamp", 33648: "mirror"}
        info = value_at(material.kept.tree, path)
        sampler = material.kept.textures[info["index"]][1]
        return codes.get(sampler.get("wrapS"), "repeat"), codes.get(sampler.get("wrapT"), "repeat")

    def _find_points(self, is_shown: NDArray[np.bool_]) -> TexelPoints:
        """Find the points of some triangles (m,) of the original at texels."""
        points = self._sources.points
        return points if is_shown.all() else points[is_shown[points.triangles]]

    def _bake_base_color(self) -> Pixels | None:
        """Bake the base colours (h, w, 3 or 4); None if the class has none."""
        mesh, one = self._part.original, self._class
        images = _list_images(self._texture, one, BASE_COLOR)
        if not images and mesh.colors is None:
            return None
        channels = 4 if self.has_alpha() else 3
        canvas = self._create_canvas((_WHITE,) * channels)
        texels = canvas.reshape(-1, channels)
        has_image = np.zeros(len(mesh.triangles), bool)
        for number in one.numbers:
            image = self._load_map(number, BASE_COLOR, channels)
            if image is None:
                continue
            is_its = self._texture.material_ids == number
            has_image |= is_its
            material = self._texture.materials[number]
            if material.base_color is not None and not self._keeps_color():
                image = _apply_tint(image, material.base_color)
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
        """Return whether any image of the class has visible transparency."""
        for number in self._class.numbers:
            image = image_at(self._texture.materials[number], BASE_COLOR) if number >= 0 else None
            if image is None or image.pixels.shape[2] < 4 or is_opaque(self._texture.materials[number]):
                continue
            if image.pixels[..., 3].min() < 255:
                return True
        return False

    def _keeps_color(self) -> bool:
        """Return whether all materials share a base colour, which then stays a factor."""
        colors = {self._texture.materials[number].base_color for number in self._class.numbers if number >= 0}
        return len(colors) == 1 and bool(_list_images(self._texture, self._class, BASE_COLOR))

    def _sample_colors(self, points: TexelPoints) -> Pixels:
        found = color_at(self._part.original, points.triangles, points.weights)
        return np.rint(found).clip(0, 255).astype(np.uint8)

    def _multiply_colors(self, sampled: Pixels, points: TexelPoints) -> Pixels:
        bare = self._part.original.with_(texture=None)
        colors = color_at(bare, points.triangles, points.weights)
        light = linear_from_srgb(_SRGB_LEVELS)[sampled] * linear_from_srgb(colors / 255)
        return np.rint(255 * srgb_from_linear(light)).clip(0, 255).astype(np.uint8)

    def _bake_map(self, path: Path) -> Pixels:
        """Bake a map other than the base colour, (h, w, 3)."""
        is_normal = path[-1].lower().endswith("normaltexture")
        canvas = self._create_canvas(_FLAT_NORMAL if is_normal else (_WHITE,) * 3)
        for number in self._class.numbers:
            image = self._load_map(number, path, 3)
            if image is not None:
                self._sample(
                    canvas, image if is_normal else self._apply_factors(image, number, path), number, path
                )
        if is_normal:
            self._transform_normals(canvas, path)
        return canvas

    def _transform_normals(self, canvas: Pixels, path: Path) -> None:
        """Transform normals from original to simplified tangent frames, in place."""
        if self._frames is None:
            self._frames = (
                tangent_frames(self._part.original, self._texture.uvs),
                tangent_frames(self._part.simplified, self._pages.uvs),
            )
        old, new = self._frames
        # One more for triangles without a material.
        scales = np.ones(len(self._texture.materials) + 1, np.float32)
        for number in self._class.numbers:
            if number >= 0:
                scales[number] = float(
                    value_at(self._texture.materials[number].kept.tree, (*path, "scale"), 1.0)
                )
        points = self._sources.points
        texels = canvas.reshape(-1, 3)
        for start in range(0, len(points.texels), _AT_ONCE):
            part = slice(start, start + _AT_ONCE)
            at, triangles = points.texels[part], points.triangles[part]
            directions = decode_normals(
                texels[at],
                old.at(triangles, points.weights[part]),
                scales[self._texture.material_ids[triangles]],
            )
            own = self._correspondence.locate_texels(self._page, at)
            texels[at] = encode_normals(directions, new.at(own.triangles, own.weights))

    def _apply_factors(self, image: Pixels, number: int, path: Path) -> Pixels:
        """Multiply a map by its factors if the materials of the class differ in them."""
        if path not in FACTORS or self._shares_factors(path):
            return image
        tree = self._texture.materials[number].kept.tree
        values = [value_at(tree, place, default) for place, default in FACTORS[path]]
        shown = image.astype(np.float32)
        if path == ("emissiveTexture",):
            return _apply_tint(image, (*map(float, srgb_from_linear(np.array(values[0]))), 1.0))
        if path == ("occlusionTexture",):
            shown = 255 + float(values[0]) * (shown - 255)
        else:
            shown[..., 1] *= float(values[0])
            shown[..., 2] *= float(values[1])
        return np.rint(shown).clip(0, 255).astype(np.uint8)

    def _shares_factors(self, path: Path) -> bool:
        """Return whether the materials of the class agree on the factors of a map."""
        found = {
            repr(
                [
                    value_at(self._texture.materials[number].kept.tree, place, default)
                    for place, default in FACTORS[path]
                ]
            )
            for number in self._class.numbers
        }
        return len(found) == 1

    def _map_key(self, path: Path) -> Any:
        """Return a key that is equal for maps with equal results."""
        is_normal = path[-1].lower().endswith("normaltexture")
        images = tuple(id(image_at(self._texture.materials[number], path)) for number in self._class.numbers)
        is_own = is_normal or (path in FACTORS and not self._shares_factors(path))
        wraps = tuple(self._get_wrap(number, path) for number in self._class.numbers)
        return (images, wraps, path if is_own else None)

    def _prepare_image(self, path: Path, canvas: Pixels, name: str) -> tuple[str, Pixels, ImageFormat]:
        """Choose name, size and format of a baked image."""
        images = _list_images(self._texture, self._class, path)
        is_color = path == BASE_COLOR or path[-1] == "emissiveTexture"
        every = images or [
            image for place in self._class.maps for image in _list_images(self._texture, self._class, place)
        ]
        form = choose_format(every, has_alpha=canvas.shape[2] == 4, is_color=is_color)
        suffix = "" if path == BASE_COLOR else f"-{path[-1].removesuffix('Texture')}"
        canvas = self._limit_size(canvas, path) if images else canvas
        return f"{name}{suffix}.{form.extension}", canvas, form

    def _limit_size(self, canvas: Pixels, path: Path) -> Pixels:
        """Halve an image until it is about as coarse as those it replaces."""
        covered = 0.0
        for number in self._class.numbers:
            image = image_at(self._texture.materials[number], path) if number >= 0 else None
            if image is not None:
                its = self._texture.material_ids == number
                covered += float(self._spread[its].sum()) * image.pixels.shape[0] * image.pixels.shape[1]
        while covered > 0 and covered < self._laid / 2 and min(canvas.shape[:2]) >= 64:
            canvas = resize_image(canvas, (canvas.shape[1] // 2, canvas.shape[0] // 2))
            covered *= 4
        return canvas

    def _build_material(self, first: Material, images: dict[Path, Image]) -> Material:
        """Build the material of the class from its baked images."""
        base = images.get(BASE_COLOR)
        color = first.base_color if self._keeps_color() or base is None else None
        clamp = ("clamp", "clamp")
        if isinstance(first.kept, MtlStatements):
            return replace(first, image=base, base_color=color, wrap=clamp, kept=_remove_maps(first.kept))
        if not isinstance(first.kept, GltfStatements):
            return replace(first, image=base, base_color=color, wrap=clamp, kept=None)
        tree = copy.deepcopy(first.kept.tree)
        for path in (BASE_COLOR, *self._class.maps):
            if path not in images:
                value_at(tree, path[:-1], {}).pop(path[-1], None)
        textures: dict[int, tuple[Image, Any]] = {}
        for index, (path, image) in enumerate(images.items()):
            holder = tree
            for key in path[:-1]:
                holder = holder.setdefault(key, {})
            info = holder.setdefault(path[-1], {})
            info["index"] = index
            textures[index] = (image, dict(_CLAMP))
            if path[-1].lower().endswith("normaltexture"):
                info.pop("scale", None)
            elif path in FACTORS and not self._shares_factors(path):
                for place, default in FACTORS[path]:
                    holder = value_at(tree, place[:-1], {})
                    holder[place[-1]] = [1.0, 1.0, 1.0] if isinstance(default, list) else 1.0
        if color is None:
            value_at(tree, ("pbrMetallicRoughness",), {}).pop("baseColorFactor", None)
        kept = GltfStatements(tree, textures, color, base, clamp)
        return replace(first, image=base, base_color=color, wrap=clamp, kept=kept)


def _remove_maps(kept: MtlStatements) -> MtlStatements:
    """Remove the maps of an MTL material, which the atlas does not hold."""
    lines, lost = [], []
    for line in kept.lines:
        key = line.split(None, 1)[0]
        if key == "map_Kd":
            continue
        if key.startswith(("map_", "bump", "norm", "disp", "decal", "refl")):
            lost.append(key)
            continue
        lines.append(line)
    if lost:
        emit(
            TEXTURE_BAKE_LEFT_OUT.warning(
                "bake left out: {maps} of the original's materials.", maps=", ".join(lost)
            )
        )
    return MtlStatements(tuple(lines), {}, kept.color, None)


def _apply_tint(texels: Pixels, color: tuple[float, ...]) -> Pixels:
    """Multiply sRGB colours (h, w, 3 or 4) by a factor in linear light."""
    import cv2

    factor = linear_from_srgb(np.array(color[:3]))
    light = linear_from_srgb(_SRGB_LEVELS)[:, None] * factor
    table = np.rint(255 * srgb_from_linear(light)).clip(0, 255).astype(np.uint8)
    if texels.shape[2] == 4:
        alpha = np.rint(np.arange(256) * color[3]).clip(0, 255).astype(np.uint8)
        table = np.column_stack([table, alpha])
    return np.asarray(cv2.LUT(texels, np.ascontiguousarray(table[None])), np.uint8)
