"""Baking: a light mesh gets a texture that holds the colours of the original surface.

Every texel is taken to its place on the light mesh, from there to the nearest point of the original that
faces the same way, and gets the colour there (Cignoni, Montani, Rocchini and Scopigno 1998, "A general method
for preserving attribute values on simplified meshes"). What is between the charts is filled from them, so
that neither bilinear sampling nor smaller copies of the image (mip levels) bring in a colour from elsewhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.atlas import Atlas, unwrap
from stages.compare import ColorError, CompareParams, compare_surfaces
from stages.convert import MeshLike, as_mesh
from stages.errors import MeshError, UsageError
from stages.mesh import Mesh
from stages.params import check, param, resolve
from stages.progress import Progress, silent
from stages.rasterize import covered, strips
from stages.raycasting import Floats, Surface, bounding_box
from stages.surface_color import color_at, has_color
from stages.texture import Image, Material, Texture
from stages.topology import areas, require_area

VERSION = 1

_MIN_SIZE = 64
# Of the image, that charts fill; used to choose its size.
_FILLED = 0.5
_LEAST_PADDING = 4
# So many texels of an image's side have one texel of padding by default.
_SIDE_PER_PADDING = 256
_MOST_SAMPLES = 4
# What is averaged in a texel by default even if it is no larger than the detail: bilinear samples of samples
# blur, and four of them blur less.
_LEAST_SAMPLES = 2
# Surfaces that are passed on the way to one that faces the right way, to each side.
_PASSED = 4
# A ray goes on behind what it met this share of its reach later.
_STEP = 1e-4
# Triangles whose middles tell how far the light mesh is from the original.
_PROBES = 100_000
_COMPARED = 200_000


@dataclass(frozen=True, kw_only=True)
class BakeParams:
    """How finely the colours of the original are kept, and in how large an image."""

    texel_size: float | None = param(
        None,
        "Size of a texel on the surface, at most; the image is the smallest that has room for it, up to "
        "max_size, and is filled. Default: half the original's mean edge, or the size of the texels it has.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_size: int = param(
        4096, "Largest side of the image: a power of two.", unit="texels", low=_MIN_SIZE, high=8192
    )
    padding: int | None = param(
        None,
        "Texels between two charts, at least, filled from the nearest. Halves of the image down to a "
        "padding-th of half its size are free of other charts' colours. Default: 1/256 of the side, at "
        "least 4.",
        unit="texels",
        low=2,
        high=256,
    )
    samples: int | None = param(
        None,
        "Samples along each side of a texel, whose mean it gets. Default: enough to meet all detail of the "
        "original, 2 to 4.",
        low=1,
        high=8,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.max_size & (self.max_size - 1):
            raise UsageError(f"max_size is {self.max_size} texels; it must be a power of two.")


@dataclass(frozen=True, eq=False)
class Baked:
    """A textured mesh and how well it shows its original.

    Attributes
    ----------
    mesh : the light mesh with one texture image, without vertex colours.
    size : texels, of a side of the image.
    texel_size : metres, of a texel on the surface, in the mean.
    coverage : share of the image that shows the surface.
    charts : pieces the surface is cut into.
    padding : texels between charts, at least.
    samples : along each side of a texel.
    turned : share of the samples whose nearest point faced away, and that took another one.
    color : difference from the original's colours, sampled on the original.
    vertex_color : the same for the light mesh's vertex colours; None if it has none.
    """

    mesh: Mesh
    size: int
    texel_size: float
    coverage: float
    charts: int
    padding: int
    samples: int
    turned: float
    color: ColorError
    vertex_color: ColorError | None

    @property
    def mip_levels(self) -> int:
        """Return how many times the image can be halved with no colour of one chart getting into another."""
        return int(math.log2(self.padding / 2)) if self.padding >= 2 else 0

    def figures(self) -> dict[str, Any]:
        """Return all figures for JSON, units in the names."""
        return {
            "triangles": len(self.mesh.triangles),
            "image_size_texels": self.size,
            "texel_size_m": self.texel_size,
            "texels_per_m": 1 / self.texel_size,
            "coverage": self.coverage,
            "charts": self.charts,
            "padding_texels": self.padding,
            "mip_levels": self.mip_levels,
            "samples_per_texel": self.samples**2,
            "turned_samples": self.turned,
            "color": self.color.figures(),
            "vertex_color": self.vertex_color and self.vertex_color.figures(),
        }


def bake(
    light: MeshLike,
    original: MeshLike,
    params: BakeParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Any,
) -> Baked:
    """Give a light mesh a texture that holds the colours of its original.

    The same meshes give the same image. Memory beside the meshes and the image is bounded.

    Parameters
    ----------
    light : Mesh, Open3D or trimesh mesh, or a pair of arrays; need not be a manifold. Its own colours and
        texture are replaced.
    original : in the same place, with vertex colours or a texture.
    params : see BakeParams; single ones can be given by name.
    progress : told of rows of the image.

    Raises
    ------
    MeshError
        If a mesh is not valid or has no area, or the original has no colours.
    StageError
        If no atlas is found, or its charts do not fit with their padding.
    """
    params = resolve(BakeParams, params, changes)
    given, reference = as_mesh(light, "light mesh"), as_mesh(original, "original")
    require_area(given, "light mesh")
    require_area(reference, "original")
    if not has_color(reference):
        raise MeshError("has neither vertex colours nor a texture; there is nothing to bake.", "original")
    detail = _detail(reference)
    size = _image_size(given, params.texel_size or detail, params.max_size)
    padding = params.padding or max(_LEAST_PADDING, size // _SIDE_PER_PADDING)
    atlas = unwrap(given, size, padding, progress)
    texel_size = _texel_size(given, atlas)
    samples = params.samples or min(max(math.ceil(texel_size / detail), _LEAST_SAMPLES), _MOST_SAMPLES)
    box = bounding_box(given, reference)
    surface = Surface(reference, box)
    image, found = _image(given, atlas, samples, _ColorFinder(surface, given), progress)
    mesh = _textured(given, atlas, image)
    error, before = (_color_error(surface, one, box) for one in (mesh, given))
    assert error is not None
    return Baked(
        mesh=mesh,
        size=size,
        texel_size=texel_size,
        coverage=found.coverage,
        charts=int(atlas.charts.max()) + 1,
        padding=padding,
        samples=samples,
        turned=found.turned,
        color=error,
        vertex_color=before if given.colors is not None else None,
    )


def _textured(mesh: Mesh, atlas: Atlas, image: NDArray[np.uint8]) -> Mesh:
    """Return the mesh with the image, and without vertex colours: a viewer would multiply the two."""
    materials = (Material(name="baked", image=Image(name="baked.png", given=image), wrap=("clamp", "clamp")),)
    material_ids = np.zeros(len(mesh.triangles), np.int32)
    return mesh.with_(colors=None, texture=Texture(atlas.uvs, material_ids, materials))


def _detail(original: Mesh) -> float:
    """Return the size, in metres, of the smallest thing the original's colours can show."""
    corners = original.vertices[original.triangles]
    area = areas(original.vertices, original.triangles)
    texture = original.texture
    if texture is not None:
        sizes = np.array([m.image.pixels.shape[:2] if m.image else (0, 0) for m in texture.materials] + [(0, 0)])
        sides = texture.uvs[:, 1:] - texture.uvs[:, :1]
        shares = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]) / 2
        texels = shares * sizes[texture.material_ids].prod(axis=1)
        on_image = texels > 0
        # Where most of the surface has a texture, that is what there is to keep.
        if area[on_image].sum() > area.sum() / 2:
            return math.sqrt(area[on_image].sum() / texels.sum())
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    return float(lengths.mean()) / 2


def _image_size(mesh: Mesh, texel_size: float, max_size: int) -> int:
    wanted = math.sqrt(areas(mesh.vertices, mesh.triangles).sum() / _FILLED) / texel_size
    size = _MIN_SIZE
    while size < min(wanted, max_size):
        size *= 2
    return size


def _texel_size(mesh: Mesh, atlas: Atlas) -> float:
    sides = atlas.corners[:, 1:] - atlas.corners[:, :1]
    texels = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0]).sum() / 2
    return math.sqrt(float(areas(mesh.vertices, mesh.triangles).sum()) / float(texels))


def _color_error(original: Surface, mesh: Mesh, box: Floats) -> ColorError | None:
    return compare_surfaces(original, Surface(mesh, box), CompareParams(samples=_COMPARED)).color_a_to_b


class _ColorFinder:
    """The colours of an original at places on a light mesh.

    Attributes
    ----------
    asked, turned : how many places there were, and at how many the nearest point faced away and another did
        not.
    """

    def __init__(self, original: Surface, light: Mesh) -> None:
        self._original = original
        self._normals = _unit_normals(original.mesh)
        self._light = light
        self._light_normals = _unit_normals(light)
        self._reach = self._farthest()
        self.asked = self.turned = 0

    def __call__(self, triangles: NDArray[np.int64], weights: Floats) -> NDArray[np.float32]:
        """Return the colours (k, 3) at points of the light mesh."""
        corners = self._light.vertices[self._light.triangles[triangles]]
        points = np.einsum("kc,kcx->kx", weights, corners)
        nearest = self._original.closest(points)
        found, shares = nearest.triangles, nearest.weights
        normals = self._light_normals[triangles]
        (away,) = np.nonzero(_dot(normals, self._normals[found]) < 0)
        if len(away):
            chosen, others, other_shares = self._facing(points[away], normals[away])
            found[away[chosen]], shares[away[chosen]] = others, other_shares
            self.turned += len(chosen)
        self.asked += len(points)
        return color_at(self._original.mesh, found, shares)

    def _farthest(self) -> float:
        """Return how far, in metres, the original is looked for along a normal.

        That is the largest distance found between the light mesh and what faces its way: where a thin sheet
        has come out on the wrong side of itself, its right side is not farther than that.
        """
        step = math.ceil(len(self._light.triangles) / _PROBES)
        rows = np.arange(0, len(self._light.triangles), step)
        middles = self._light.vertices[self._light.triangles[rows]].mean(axis=1)
        nearest = self._original.closest(middles)
        agrees = _dot(self._light_normals[rows], self._normals[nearest.triangles]) > 0
        return float(nearest.distances[agrees].max(initial=0.0))

    def _facing(
        self, points: Floats, normals: Floats
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], Floats]:
        """Return, for which points there is a surface within reach along the normal that faces its way.

        Returns
        -------
        The points' numbers, and the triangles and weights of the nearest such surface, to either side.
        """
        best = np.full(len(points), self._reach)
        triangles = np.full(len(points), -1, np.int64)
        weights = np.zeros((len(points), 3))
        for side in (1, -1):
            rays, starts = np.arange(len(points)), np.zeros(len(points), np.float32)
            for _ in range(_PASSED):
                hits = self._original.cast(points[rays], side * normals[rays], starts)
                rows = rays[hits.rays]
                near = hits.distances < best[rows]
                facing = near & (_dot(normals[rows], self._normals[hits.triangles]) > 0)
                best[rows[facing]] = hits.distances[facing]
                triangles[rows[facing]], weights[rows[facing]] = hits.triangles[facing], hits.weights[facing]
                on = near & ~facing
                rays, starts = rows[on], hits.distances[on] + np.float32(_STEP * self._reach)
                if not len(rays):
                    break
        (found,) = np.nonzero(triangles >= 0)
        return found, triangles[found], weights[found]


@dataclass(frozen=True)
class _Found:
    coverage: float
    turned: float


def _image(
    mesh: Mesh, atlas: Atlas, samples: int, colors_of: _ColorFinder, progress: Progress
) -> tuple[NDArray[np.uint8], _Found]:
    """Return the image of an atlas, full to its edges."""
    size = atlas.size
    image = np.zeros((size, size, 3), np.float32)
    filled = np.zeros((size, size), bool)
    for start, end in strips(size, size * samples**2):
        image[start:end], filled[start:end] = _strip(atlas, (start, end), samples, colors_of)
        progress(end, size)
    _mark_small(atlas, image, filled, colors_of)
    coverage = float(filled.mean())
    turned = colors_of.turned / max(colors_of.asked, 1)
    return _full(image, filled, atlas.padding), _Found(coverage, turned)


def _strip(
    atlas: Atlas, rows: tuple[int, int], samples: int, colors_of: _ColorFinder
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return rows of the image, and which texels have at least one sample on the surface."""
    fine = (rows[0] * samples, rows[1] * samples)
    found = covered(atlas.corners * samples, fine, atlas.size * samples)
    colors = colors_of(found.triangles, found.weights)
    texels = (found.rows // samples - rows[0]) * atlas.size + found.columns // samples
    count = (rows[1] - rows[0]) * atlas.size
    hits = np.bincount(texels, minlength=count)
    sums = [np.bincount(texels, colors[:, channel], minlength=count) for channel in range(3)]
    means = np.stack(sums, axis=1) / np.maximum(hits, 1)[:, None]
    return means.reshape(-1, atlas.size, 3).astype(np.float32), (hits > 0).reshape(-1, atlas.size)


def _mark_small(
    atlas: Atlas, image: NDArray[np.float32], filled: NDArray[np.bool_], colors_of: _ColorFinder
) -> None:
    """Give triangles too small to hold a sample the texel at their middle, where nothing else has it."""
    column, row = np.floor(atlas.corners.mean(axis=1)).astype(np.int64).clip(0, atlas.size - 1).T
    (missed,) = np.nonzero((atlas.charts >= 0) & ~filled[row, column])
    row, column = row[missed], column[missed]
    image[row, column] = colors_of(missed, np.full((len(missed), 3), 1 / 3))
    filled[row, column] = True


def _full(image: NDArray[np.float32], filled: NDArray[np.bool_], padding: int) -> NDArray[np.uint8]:
    """Fill the gaps: near charts with the colour of the nearest texel, beyond with means that grow softer."""
    import cv2

    # Labels number the filled texels; each texel gets that of the nearest.
    distance, labels = cv2.distanceTransformWithLabels(
        (~filled).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5, labelType=cv2.DIST_LABEL_PIXEL
    )
    source = np.zeros(labels.max() + 1, np.int64)
    source[labels[filled]] = np.flatnonzero(filled)
    near = distance <= padding
    dilated = image.reshape(-1, 3)[source[labels[near]]]
    image[near] = dilated
    pulled = _pull_push(image, near)
    return np.asarray(np.rint(pulled).clip(0, 255), np.uint8)


def _pull_push(image: NDArray[np.float32], known: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Fill what is not known from coarser and coarser means (Gortler et al. 1996, "The Lumigraph", 4.3)."""
    if known.all() or len(image) == 1:
        return image
    halves = (len(image) // 2, 2, len(image) // 2, 2)
    weight = known.reshape(halves).sum(axis=(1, 3))
    sums = np.where(known[:, :, None], image, 0).reshape(*halves, 3).sum(axis=(1, 3))
    coarse = _pull_push((sums / np.maximum(weight, 1)[:, :, None]).astype(np.float32), weight > 0)
    return np.where(known[:, :, None], image, coarse.repeat(2, axis=0).repeat(2, axis=1))


def _unit_normals(mesh: Mesh) -> Floats:
    a, b, c = mesh.vertices[mesh.triangles].swapaxes(0, 1)
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)


def _dot(a: Floats, b: Floats) -> Floats:
    return np.asarray(np.einsum("kx,kx->k", a, b))
