"""Image-based comparison of two meshes, rendered from the same viewpoints.

PSNR is computed over the pixels that both meshes cover. SSIM follows Wang, Bovik, Sheikh and Simoncelli,
"Image quality assessment: from error visibility to structural similarity", 2004, over the windows that both
meshes cover completely.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.comparison_inputs import compute_joint_box, to_measurable_mesh
from scanloom.stages.comparing.mesh_rendering import render_from_pose
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.rendering.render import RenderModel
from scanloom.stages.rendering.viewpoints import Viewpoint, viewpoints
from scanloom.stages.scans.model.scan import Camera, ColorImage
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike
from scanloom.stages.surface.raycasting import RaycastingSurface
from scanloom.stages.surface.surface_color import has_color

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ViewsKeywords

Levels = NDArray[np.float32]
Mask = NDArray[np.bool_]

# Number of viewpoints if none is given.
_DEFAULT_VIEW_COUNT = 6
# Rays per pixel along each side: antialiased, as a camera averages over pixels.
_SUPERSAMPLING = 2
# Window of SSIM: standard deviation and radius, pixels.
_SSIM_SIGMA, _SSIM_RADIUS = 1.5, 5
# Mean squared difference up to which images are equal except for rounding, levels².
_EQUAL_MSE = 1e-8
# Amplification of differences in the difference image.
_DIFFERENCE_GAIN = 4
_ONLY_A, _ONLY_B, _NEITHER = (200, 60, 40), (45, 160, 70), (255, 255, 255)


@dataclass(frozen=True, kw_only=True)
class ViewsParams:
    """Parameters of the image-based comparison."""

    views: int = param(
        0,
        "Viewpoints around both meshes. 0 means none on the command line, and 6 in Python.",
        low=0,
        high=360,
    )
    view_width: int = param(800, "Width of the images, which are 4:3.", unit="px", low=64, high=4096)

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, eq=False)
class ViewScore:
    """Image similarity of two meshes from one viewpoint.

    Attributes
    ----------
    name : of the viewpoint.
    pixels, mean_squared : number of pixels that both cover, and the mean of their squared differences,
        levels².
    window_count, ssim_sum : number of SSIM windows that both cover completely, and the sum of their SSIM.
    both_pixels, either_pixels : number of pixels that both cover, and that at least one covers.
    image : A | B | difference, side by side. The difference is white for 0 and amplified 4 times; pixels that
        only A covers are red, pixels that only B covers green.
    """

    name: str
    pixels: int
    mean_squared: float
    window_count: int
    ssim_sum: float
    both_pixels: int
    either_pixels: int
    image: ColorImage

    __repr__ = format_by_metrics

    def to_dict(self) -> dict[str, Any]:
        """Return PSNR in dB (None for equal images), SSIM and silhouette agreement."""
        return {"viewpoint": self.name, **_combine_metrics([self])}


@dataclass(frozen=True, eq=False)
class ViewComparison:
    """Image similarity of two meshes over several viewpoints.

    Attributes
    ----------
    colored : unlit colours were compared. If False, shaded clay was compared, which shows the shape only.
    scores : of each viewpoint.
    """

    colored: bool
    scores: tuple[ViewScore, ...]

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def worst(self) -> ViewScore:
        """Score of the view with the lowest PSNR."""
        return max(self.scores, key=lambda one: one.mean_squared)

    def to_dict(self) -> dict[str, Any]:
        """Return PSNR and SSIM over all views together, and of each view."""
        return {
            "compared": "colors" if self.colored else "shape",
            **_combine_metrics(self.scores),
            "worst": self.worst.name,
            "each": [one.to_dict() for one in self.scores],
        }


def compare_views(
    a: MeshLike, b: MeshLike, params: ViewsParams | None = None, **changes: Unpack[ViewsKeywords]
) -> ViewComparison:
    """Render two meshes from the same viewpoints and compare the images.

    If both meshes have colours, unlit colours are compared, otherwise shaded clay.

    Parameters
    ----------
    a, b : Mesh, Open3D or trimesh mesh, or (vertices, triangles); metres, in the same coordinates.
    params : ViewsParams; single parameters can be given by keyword instead.

    Returns
    -------
    ViewComparison

    Raises
    ------
    MeshError
        If a mesh has no area.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(ViewsParams, params, changes)
    meshes = to_measurable_mesh(a, "first mesh"), to_measurable_mesh(b, "second mesh")
    chosen_viewpoints = viewpoints(
        _concatenate_meshes(*meshes), params.views or _DEFAULT_VIEW_COUNT, width=params.view_width
    )
    colored = all(map(has_color, meshes))
    box = compute_joint_box(*meshes)
    surfaces = [RaycastingSurface(mesh, box) for mesh in meshes]
    models = None if colored else [RenderModel(surface) for surface in surfaces]
    return ViewComparison(colored, tuple(_score(one, surfaces, models) for one in chosen_viewpoints))


def _concatenate_meshes(a: Mesh, b: Mesh) -> Mesh:
    """Concatenate two meshes, to choose viewpoints that show both."""
    triangles = np.concatenate([a.triangles, b.triangles + len(a.vertices)]).astype(np.int32)
    return Mesh(np.concatenate([a.vertices, b.vertices]), triangles, up=a.up or b.up)


def _score(
    viewpoint: Viewpoint, surfaces: Sequence[RaycastingSurface], models: Sequence[RenderModel] | None
) -> ViewScore:
    import cv2

    fine_viewpoint = replace(viewpoint, camera=_upscale_camera(viewpoint.camera))
    renderings = [
        render_from_pose(surface, fine_viewpoint.camera, fine_viewpoint.world_from_camera)
        for surface in surfaces
    ]
    levels = [one.levels for one in renderings]
    if models is not None:
        levels = [model.draw(fine_viewpoint, "plain").astype(np.float32) for model in models]
    hit_a, hit_b = (_average_pixels(one.hit_mask.astype(np.float32)) for one in renderings)
    a = _average_pixels(levels[0] * renderings[0].hit_mask[..., None], hit_a)
    b = _average_pixels(levels[1] * renderings[1].hit_mask[..., None], hit_b)
    # Partially covered pixels are means over different areas, so they are excluded.
    is_covered_by_both = (hit_a == 1) & (hit_b == 1)
    squared = np.asarray((a - b) ** 2, np.float64).mean(axis=2)[is_covered_by_both]
    # Pixels outside the image count as uncovered.
    window, border = np.ones((2 * _SSIM_RADIUS + 1,) * 2, np.uint8), cv2.BORDER_CONSTANT
    is_window_covered = cv2.erode(
        is_covered_by_both.astype(np.uint8), window, borderType=border, borderValue=0
    )
    ssim = _compute_ssim(a, b)[is_window_covered > 0]
    return ViewScore(
        name=viewpoint.name,
        pixels=len(squared),
        mean_squared=float(squared.mean()) if len(squared) else 0.0,
        window_count=len(ssim),
        ssim_sum=float(ssim.sum()),
        both_pixels=int(np.count_nonzero((hit_a > 0) & (hit_b > 0))),
        either_pixels=int(np.count_nonzero((hit_a > 0) | (hit_b > 0))),
        image=_draw_comparison(a, b, hit_a > 0, hit_b > 0),
    )


def _upscale_camera(camera: Camera) -> Camera:
    """Return the camera with a higher resolution and the same field of view."""
    return Camera(
        camera.width * _SUPERSAMPLING,
        camera.height * _SUPERSAMPLING,
        camera.fx * _SUPERSAMPLING,
        camera.fy * _SUPERSAMPLING,
        (camera.cx + 0.5) * _SUPERSAMPLING - 0.5,
        (camera.cy + 0.5) * _SUPERSAMPLING - 0.5,
    )


def _average_pixels(image: Levels, covered: Levels | None = None) -> Levels:
    """Average blocks of pixels to the original resolution, over the covered ratio (h, w)."""
    height, width = image.shape[:2]
    parts = image.reshape(
        height // _SUPERSAMPLING, _SUPERSAMPLING, width // _SUPERSAMPLING, _SUPERSAMPLING, *image.shape[2:]
    )
    means = parts.mean(axis=(1, 3))
    if covered is not None:
        means /= np.where(covered > 0, covered, 1)[..., None]
    return np.asarray(means, np.float32)


def _compute_ssim(a: Levels, b: Levels) -> Levels:
    """Compute the SSIM map (h, w), averaged over channels."""
    from skimage.metrics import structural_similarity

    _, similar = structural_similarity(  # type: ignore[no-untyped-call]
        a,
        b,
        channel_axis=2,
        data_range=255,
        gaussian_weights=True,
        sigma=_SSIM_SIGMA,
        use_sample_covariance=False,
        full=True,
    )
    return np.asarray(similar.mean(axis=2))


def _draw_comparison(a: Levels, b: Levels, covers_a: Mask, covers_b: Mask) -> ColorImage:
    max_difference = np.abs(a - b).max(axis=2, keepdims=True)
    difference = np.repeat(255 - _DIFFERENCE_GAIN * max_difference, 3, axis=2)
    difference[covers_a & ~covers_b] = _ONLY_A
    difference[covers_b & ~covers_a] = _ONLY_B
    for image, covers in ((a, covers_a), (b, covers_b), (difference, covers_a | covers_b)):
        image[~covers] = _NEITHER
    return np.asarray(np.rint(np.hstack([a, b, difference])).clip(0, 255), np.uint8)


def _combine_metrics(scores: Sequence[ViewScore]) -> dict[str, Any]:
    """Combine the metrics of views, weighted by pixels and windows."""
    pixels, windows = sum(one.pixels for one in scores), sum(one.window_count for one in scores)
    squared = sum(one.pixels * one.mean_squared for one in scores) / max(pixels, 1)
    return {
        "psnr_db": 10 * math.log10(255**2 / squared) if squared > _EQUAL_MSE else None,
        "ssim": sum(one.ssim_sum for one in scores) / windows if windows else None,
        "silhouette_iou": sum(one.both_pixels for one in scores)
        / max(sum(one.either_pixels for one in scores), 1),
        "pixels_compared": pixels,
    }
