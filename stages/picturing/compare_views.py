"""How alike two meshes look: both drawn from the same viewpoints, and the pictures compared.

PSNR is of the pixels that both cover. SSIM is that of Wang, Bovik, Sheikh and Simoncelli, "Image quality
assessment: from error visibility to structural similarity", 2004, over the windows that both cover whole.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.measurable import box_of, measurable
from scanloom.stages.comparing.seen import seen_from
from scanloom.stages.params import check, param, resolve
from scanloom.stages.picturing.render import Model
from scanloom.stages.picturing.viewpoints import Viewpoint, viewpoints
from scanloom.stages.printing import by_figures, table
from scanloom.stages.scans.model.scan import Camera, ColorImage
from scanloom.stages.surface.color import has_color
from scanloom.stages.surface.convert import MeshLike
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ViewsKeywords

Levels = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Where no number of viewpoints is given.
_USUAL = 6
# Rays a pixel along each side: what is compared are means over pixels, as a camera sees them.
_FINER = 2
# Window of SSIM: its standard deviation, and how far it reaches, pixels.
_SIGMA, _REACH = 1.5, 5
# Equal to rounding, levels².
_EQUAL = 1e-8
# Of a difference, in its picture.
_TIMES = 4
_ONLY_A, _ONLY_B, _NEITHER = (200, 60, 40), (45, 160, 70), (255, 255, 255)


@dataclass(frozen=True, kw_only=True)
class ViewsParams:
    """From where two meshes are drawn to be compared."""

    views: int = param(
        0, "Viewpoints around both that they are drawn from. 0: none, or 6 from Python.", low=0, high=360
    )
    view_width: int = param(800, "Width of the pictures; they are 4:3.", unit="px", low=64, high=4096)

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, eq=False)
class ViewScore:
    """How alike two meshes look from one viewpoint.

    Attributes
    ----------
    name : of the viewpoint.
    pixels, squared : that both cover, and the mean of their squared differences, levels².
    windows, similar : that both cover whole, and the sum of their SSIM.
    both, either : pixels that both cover, and that any does.
    picture : A | B | their difference, four times as large, from white for none; what A alone covers is red
        in it, and B alone green.
    """

    name: str
    pixels: int
    squared: float
    windows: int
    similar: float
    both: int
    either: int
    picture: ColorImage

    __repr__ = by_figures

    def figures(self) -> dict[str, Any]:
        """Return PSNR in dB (None for equal pictures), SSIM, and how the silhouettes agree."""
        return {"viewpoint": self.name, **_figures([self])}


@dataclass(frozen=True, eq=False)
class ViewComparison:
    """How alike two meshes look.

    Attributes
    ----------
    colored : whether their own colours were compared, without any light; else clay under a light was, which
        shows shape alone.
    scores : of each viewpoint.
    """

    colored: bool
    scores: tuple[ViewScore, ...]

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def worst(self) -> ViewScore:
        """The view of the lowest PSNR."""
        return max(self.scores, key=lambda one: one.squared)

    def figures(self) -> dict[str, Any]:
        """Return PSNR and SSIM over the pixels and windows of all views together, and of each."""
        return {
            "compared": "colors" if self.colored else "shape",
            **_figures(self.scores),
            "worst": self.worst.name,
            "each": [one.figures() for one in self.scores],
        }


def compare_views(
    a: MeshLike, b: MeshLike, params: ViewsParams | None = None, **changes: Unpack[ViewsKeywords]
) -> ViewComparison:
    """Draw two meshes from the same viewpoints, and tell how alike the pictures are.

    Where both have colours, these are compared as they are, whatever the light; else how they are shaded.

    Parameters
    ----------
    a, b : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres, in one place.
    params : ViewsParams; single fields can be given by name instead.

    Raises
    ------
    MeshError
        If a mesh has no area.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(ViewsParams, params, changes)
    meshes = measurable(a, "first mesh"), measurable(b, "second mesh")
    around = viewpoints(_joined(*meshes), params.views or _USUAL, width=params.view_width)
    colored = all(map(has_color, meshes))
    box = box_of(*meshes)
    surfaces = [Surface(mesh, box) for mesh in meshes]
    models = None if colored else [Model(surface) for surface in surfaces]
    return ViewComparison(colored, tuple(_score(one, surfaces, models) for one in around))


def _joined(a: Mesh, b: Mesh) -> Mesh:
    """Return both as one, to choose viewpoints that show both."""
    triangles = np.concatenate([a.triangles, b.triangles + len(a.vertices)]).astype(np.int32)
    return Mesh(np.concatenate([a.vertices, b.vertices]), triangles, up=a.up or b.up)


def _score(viewpoint: Viewpoint, surfaces: Sequence[Surface], models: Sequence[Model] | None) -> ViewScore:
    import cv2

    finer = replace(viewpoint, camera=_finer(viewpoint.camera))
    seen = [seen_from(surface, finer.camera, finer.world_from_camera) for surface in surfaces]
    levels = [one.levels for one in seen]
    if models is not None:
        levels = [model.draw(finer, "plain").astype(np.float32) for model in models]
    hit_a, hit_b = (_coarser(one.hit.astype(np.float32)) for one in seen)
    a = _coarser(levels[0] * seen[0].hit[..., None], hit_a)
    b = _coarser(levels[1] * seen[1].hit[..., None], hit_b)
    # Where it is covered in part, a pixel is no mean over the same places.
    both = (hit_a == 1) & (hit_b == 1)
    squared = np.asarray((a - b) ** 2, np.float64).mean(axis=2)[both]
    # Beyond the picture nothing is covered.
    window, border = np.ones((2 * _REACH + 1,) * 2, np.uint8), cv2.BORDER_CONSTANT
    whole = cv2.erode(both.astype(np.uint8), window, borderType=border, borderValue=0)
    similar = _similarity(a, b)[whole > 0]
    return ViewScore(
        name=viewpoint.name,
        pixels=len(squared),
        squared=float(squared.mean()) if len(squared) else 0.0,
        windows=len(similar),
        similar=float(similar.sum()),
        both=int(np.count_nonzero((hit_a > 0) & (hit_b > 0))),
        either=int(np.count_nonzero((hit_a > 0) | (hit_b > 0))),
        picture=_picture(a, b, hit_a > 0, hit_b > 0),
    )


def _finer(camera: Camera) -> Camera:
    """Return a camera of more pixels that sees the same."""
    return Camera(
        camera.width * _FINER,
        camera.height * _FINER,
        camera.fx * _FINER,
        camera.fy * _FINER,
        (camera.cx + 0.5) * _FINER - 0.5,
        (camera.cy + 0.5) * _FINER - 0.5,
    )


def _coarser(image: Levels, covered: Levels | None = None) -> Levels:
    """Return the means of the pixels that `_finer` made of each, over the share (h, w) that is covered."""
    height, width = image.shape[:2]
    parts = image.reshape(height // _FINER, _FINER, width // _FINER, _FINER, *image.shape[2:])
    means = parts.mean(axis=(1, 3))
    if covered is not None:
        means /= np.where(covered > 0, covered, 1)[..., None]
    return np.asarray(means, np.float32)


def _similarity(a: Levels, b: Levels) -> Levels:
    """Return SSIM (h, w) of the window around each pixel, the mean over the channels."""
    from skimage.metrics import structural_similarity

    _, similar = structural_similarity(  # type: ignore[no-untyped-call]
        a,
        b,
        channel_axis=2,
        data_range=255,
        gaussian_weights=True,
        sigma=_SIGMA,
        use_sample_covariance=False,
        full=True,
    )
    return np.asarray(similar.mean(axis=2))


def _picture(a: Levels, b: Levels, covers_a: Mask, covers_b: Mask) -> ColorImage:
    away = np.abs(a - b).max(axis=2, keepdims=True)
    difference = np.repeat(255 - _TIMES * away, 3, axis=2)
    difference[covers_a & ~covers_b] = _ONLY_A
    difference[covers_b & ~covers_a] = _ONLY_B
    for image, covers in ((a, covers_a), (b, covers_b), (difference, covers_a | covers_b)):
        image[~covers] = _NEITHER
    return np.asarray(np.rint(np.hstack([a, b, difference])).clip(0, 255), np.uint8)


def _figures(scores: Sequence[ViewScore]) -> dict[str, Any]:
    """Return the figures of views together: each pixel, and each window, counts as much as any other."""
    pixels, windows = sum(one.pixels for one in scores), sum(one.windows for one in scores)
    squared = sum(one.pixels * one.squared for one in scores) / max(pixels, 1)
    return {
        "psnr_db": 10 * math.log10(255**2 / squared) if squared > _EQUAL else None,
        "ssim": sum(one.similar for one in scores) / windows if windows else None,
        "silhouette_iou": sum(one.both for one in scores) / max(sum(one.either for one in scores), 1),
        "pixels_compared": pixels,
    }
