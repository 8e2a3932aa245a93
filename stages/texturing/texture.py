"""Texturing of a mesh from camera images.

The surface is laid out in images with about the resolution of the photos. Each texel is projected into all
photos. A photo is rejected where the texel is occluded, contradicts the frame's depth or is at the image
border. The best few photos are corrected in exposure and blended in two frequency bands, weighted by viewing
quality. Seams at the borders of photos are levelled.

Then each photo is aligned with the texture, by small shifts and a local exposure correction, and the texture
is painted again. If the photos are aligned already, back-projection recovers the details lost in the mean.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.image_bytes import encode_image
from scanloom.stages.params import check_parameters, param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import run_concurrently
from scanloom.stages.scans.model.scan import Frame, Scan, SkippedFrame
from scanloom.stages.surface.formats.gltf_materials import make_unlit_source
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import require_area
from scanloom.stages.surface.vertex_normals import compute_vertex_normals
from scanloom.stages.texturing.atlas_layout import AtlasLayout, lay_out_by_density
from scanloom.stages.texturing.codes import (
    TEXTURE_PHOTOS_INCONSISTENT,
    TEXTURE_PHOTOS_UNUSABLE,
    TEXTURE_SURFACE_UNSEEN,
)
from scanloom.stages.texturing.exposure import Exposures
from scanloom.stages.texturing.gap_filling import fill_gaps_smoothly
from scanloom.stages.texturing.local_exposure import to_levels
from scanloom.stages.texturing.photo_painting import (
    DETAIL_PASSES,
    PaintedImage,
    Painter,
    PhotoSelection,
    quantize_levels,
)
from scanloom.stages.texturing.photo_sampling import PhotoCorrection, RenderMesh, prepare_render_mesh
from scanloom.stages.texturing.photo_survey import reject_inconsistent_photos, survey_photos
from scanloom.stages.texturing.photos import Photos, load_photos
from scanloom.stages.texturing.seam_visibility import SeamStatistics

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import TextureKeywords

# Also covers `bake_normal_map`, which the stage runs on the result.
RESULT_VERSION = 17

_MIN_SIZE = 64
# Median shift as a ratio of a photo's width, below which photos count as aligned.
_ALIGNED_SHIFT_RATIO = 0.3 / 640
# Median local exposure correction in levels, below which no seam is visible.
_INVISIBLE_LEVELS = 1.0
# Thresholds of warnings: ratio of the surface that no photo shows, and difference between photos in levels.
_WARN_UNSEEN_RATIO = 0.5
_WARN_DIFFERENCE_LEVELS = 20.0
# Shift as a ratio of a photo's width, above which photos are misaligned enough for a warning.
_WARN_SHIFT_RATIO = 2.0 / 640

_GROUP_OUTPUT = "Output images"
_GROUP_BLENDING = "Blending"


@dataclass(frozen=True, kw_only=True)
class TextureParams:
    """Parameters of texturing from photos: output images and blending."""

    texels_per_pixel: float = param(
        1.15,
        "Texels per pixel along each side, relative to the photo that shows the surface best.",
        group=_GROUP_OUTPUT,
        low=0.1,
        high=4,
    )
    max_size: int = param(
        4096,
        "Longest side of an image; a power of two. Several images are written if one is not enough.",
        group=_GROUP_OUTPUT,
        unit="texels",
        low=_MIN_SIZE,
        high=16384,
    )
    max_texels: float = param(
        64.0,
        "Limit of all images together; all texels get larger if more would be needed.",
        group=_GROUP_OUTPUT,
        unit="million texels",
        low=0.01,
        high=1000,
    )
    format: str = param(
        "jpeg", "File format of the images.", group=_GROUP_OUTPUT, choices=("jpeg", "webp", "png")
    )
    quality: int = param(95, "Quality of JPEG and WebP images.", group=_GROUP_OUTPUT, low=1, high=100)
    padding: int = param(
        4,
        "Texels around each chart that continue its colours; the gap between two charts is twice as wide.",
        group=_GROUP_OUTPUT,
        unit="texels",
        low=2,
        high=128,
    )
    views: int = param(
        12, "Maximum number of photos blended at a texel.", group=_GROUP_BLENDING, low=1, high=16
    )
    exposure: bool = param(
        True,
        "Correct exposure differences between photos: gain and bias per photo and channel, one vignette, "
        "and local corrections in each of the `alignment_iterations`.",
        group=_GROUP_BLENDING,
    )
    alignment_iterations: int = param(
        1,
        "Passes that align photos with the texture, by shifts of a few pixels and local exposure "
        "corrections. Skipped if the photos are aligned already.",
        group=_GROUP_BLENDING,
        low=0,
        high=10,
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


@dataclass(frozen=True, eq=False)
class TextureResult:
    """Mesh textured from photos, with quality metrics.

    Attributes
    ----------
    mesh : with texture images, without vertex colours.
    photos : names of the frames that were used.
    camera_centers : (k, 3) camera centres of these frames, metres.
    skipped : frames that were not used, and the reason.
    sizes : (width, height) of each image, texels.
    charts : number of charts.
    filled_ratio : ratio of the images that shows the surface.
    texel_size : median size of a texel on the surface, metres.
    coverage_ratio : ratio of the surface area that at least one photo shows; the rest keeps the vertex
        colours.
    photos_per_texel : mean number of photos blended per texel.
    difference_before, difference_after : median difference between photos and their mean, in levels, without
        and with exposure correction.
    gain_range : minimum and maximum gain over photos and channels.
    vignette_ratio : ratio of the light lost in the corners.
    shift_ratio : median over the photos of their mean shift, as a ratio of the photo's width.
    residual_exposure_levels : median over the photos of their mean local exposure correction, levels.
    seam_ratio : mean colour difference (CIE 1976) across seams, relative to other neighbouring texels; None
        if
        there are too few pairs.
    seam_ratio_over_photos : `seam_ratio` divided by the same ratio in single photos that show both texels.
        Photos often
        end at occlusion boundaries; this ratio compensates for that.
    labels : for each image, (h, w) int32, photo with the highest weight; -1 if no photo shows the surface.
    photo_counts : for each image, (h, w) uint8, number of blended photos.
    layout : layout of the mesh in the images.
    diagnostics : warnings.
    """

    mesh: Mesh
    photos: tuple[str, ...]
    camera_centers: NDArray[np.float64]
    skipped: tuple[SkippedFrame, ...]
    sizes: tuple[tuple[int, int], ...]
    charts: int
    filled_ratio: float
    texel_size: float
    coverage_ratio: float
    photos_per_texel: float
    difference_before: float
    difference_after: float
    gain_range: tuple[float, float]
    vignette_ratio: float
    shift_ratio: float
    residual_exposure_levels: float
    seam_ratio: float | None
    seam_ratio_over_photos: float | None
    labels: tuple[NDArray[np.int32], ...]
    photo_counts: tuple[NDArray[np.uint8], ...]
    layout: AtlasLayout
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return all metrics for JSON, with units in the keys."""
        return {
            "triangles": len(self.mesh.triangles),
            "photos": len(self.photos),
            "frames_skipped": [one.to_dict() for one in self.skipped],
            "images": [list(size) for size in self.sizes],
            "charts": self.charts,
            "filled_ratio": self.filled_ratio,
            "texel_size_m": self.texel_size,
            "coverage_ratio": self.coverage_ratio,
            "photos_per_texel": self.photos_per_texel,
            "difference_before_levels": self.difference_before,
            "difference_after_levels": self.difference_after,
            "gain_min": self.gain_range[0],
            "gain_max": self.gain_range[1],
            "vignette_ratio": self.vignette_ratio,
            "shift_ratio_of_width": self.shift_ratio,
            "residual_exposure_levels": self.residual_exposure_levels,
            "seam_ratio": self.seam_ratio,
            "seam_ratio_over_photos": self.seam_ratio_over_photos,
        }


def texture(
    mesh: MeshLike,
    frames: Scan | Iterable[Frame],
    params: TextureParams | None = None,
    *,
    progress: Progress = ignore_progress,
    **changes: Unpack[TextureKeywords],
) -> TextureResult:
    """Texture a mesh from the photos of a scan.

    The result is byte-identical for the same inputs, on any number of threads. Memory besides the mesh and
    the images is bounded, whatever the number of photos.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh mesh, or a pair of arrays, in the world coordinates of the poses; need not
        be manifold. Vertex colours are used where no photo shows the surface. An existing texture is
        replaced.
    frames : scan or frames with colour images and poses. Depth is optional; photos that contradict the depth
        of their frame are not used there.
    params : see TextureParams; single parameters can be given by keyword.
    progress : called with the progress in thousandths.

    Returns
    -------
    Textured : the mesh with images, and quality metrics.

    Raises
    ------
    MeshError
        If the mesh is invalid or has no area.
    InputError
        If no frame has a usable photo, or no photo shows the mesh.

    References
    ----------
    Multi-band blending: Burt and Adelson 1983. Shifts: Zhou and Koltun 2014. Exposures: Goldman 2010.
    """
    params = resolve(TextureParams, params, changes)
    with collecting() as diagnostics:
        textured = _texture_mesh(mesh, frames, params, progress)
    return replace(textured, diagnostics=tuple(diagnostics))


def _texture_mesh(
    mesh: MeshLike, frames: Scan | Iterable[Frame], params: TextureParams, progress: Progress
) -> TextureResult:
    given = as_mesh(mesh)
    require_area(given, "mesh")
    folder = frames.folder if isinstance(frames, Scan) else None
    all_frames = list(frames.frames if isinstance(frames, Scan) else frames)
    colored = [frame for frame in all_frames if frame.color is not None]
    if not colored:
        raise InputError(
            TEXTURE_PHOTOS_UNUSABLE,
            "none of the {shown_count} frames has a colour image.",
            folder,
            shown_count=len(all_frames),
        )
    splitter = _ProgressSplitter(progress, len(colored))
    photos = load_photos(colored, splitter.start_step(0.1))
    if not len(photos):
        first = photos.skipped[0]
        raise InputError(
            TEXTURE_PHOTOS_UNUSABLE,
            "none of the {colored_count} photos can be used (frame {first_name}: {reason}).",
            folder,
            colored_count=len(colored),
            first_name=first.name,
            reason=first.reason,
        )
    normals = compute_vertex_normals(given)
    render_mesh = prepare_render_mesh(given)
    used, exposures, parts, pages, coverage_ratio = _survey_and_lay_out(
        given, render_mesh, normals, photos, params, splitter
    )
    photo_selection = PhotoSelection(used, exposures.photos, parts)
    painter = Painter(
        given, render_mesh, normals, pages, photo_selection, params.views, corrects_exposure=params.exposure
    )
    iterations = params.alignment_iterations
    step_ratio = 0.7 / (1 + iterations)
    painted: Iterable[PaintedImage] = painter.paint(
        None,
        splitter.start_photo_step(0.25 + step_ratio, painter.batch_count),
        keeps_selection=iterations > 0,
    )
    finish = partial(_finish_image, padding=pages.padding, params=params)
    shift = residual_exposure = 0.0
    for iteration in range(iterations):
        seams = SeamStatistics()
        images, kept_images, finished = _collect_levels(
            painted, partial(finish, seams=seams), keep=len(pages.sizes) == 1
        )
        corrections = painter.estimate_corrections(
            images, splitter.start_photo_step(0.25 + step_ratio * (iteration + 1.3))
        )
        del images
        # Only the first corrections measure the misalignment of the original photos.
        shift, residual_exposure = (
            shift or _measure_shift(corrections, used),
            residual_exposure or _measure_residual_exposure(corrections),
        )
        if shift < _ALIGNED_SHIFT_RATIO and residual_exposure < _INVISIBLE_LEVELS:
            if painter.can_add_details:
                seams = SeamStatistics()
                kept_images = [
                    painter.paint_details(kept_images[0], splitter.start_photo_step(1.0, DETAIL_PASSES))
                ]
            finished = finished or [finish(one, seams=seams) for one in kept_images]
            break
        del kept_images, finished
        done = splitter.start_photo_step(0.25 + step_ratio * (iteration + 2), painter.batch_count)
        painted = painter.paint(corrections, done, keeps_selection=iteration + 1 < iterations)
    else:
        seams = SeamStatistics()
        # No variable keeps an image while the next one is painted.
        finished = list(map(partial(finish, seams=seams), painted))
    progress(1000, 1000)
    metrics = _TexturingMetrics(
        used,
        exposures,
        coverage_ratio,
        shift,
        residual_exposure,
        seams.compute_ratio(),
        seams.compute_ratio_over_photos(),
    )
    _report(given, metrics)
    return _make_result(given, metrics, pages, finished)


@dataclass(frozen=True, eq=False)
class _TexturingMetrics:
    """Intermediate results of texturing; see `TextureResult`."""

    photos: Photos
    exposures: Exposures
    coverage_ratio: float
    shift_ratio: float
    residual_exposure_levels: float
    seam_ratio: float | None
    seam_ratio_over_photos: float | None


class _ProgressSplitter:
    """Overall progress in thousandths, composed of consecutive work steps.

    Each step advances from the current state to a ratio of all work.
    """

    def __init__(self, progress: Progress, photos: int) -> None:
        self._progress, self._photos, self._done = progress, photos, 0.0

    def start_step(self, until: float) -> Progress:
        start = self._done
        self._done = until

        def report(done: int, total: int) -> None:
            self._progress(round(1000 * (start + (until - start) * done / max(total, 1))), 1000)

        return report

    def start_photo_step(self, until: float, passes: int = 1) -> Callable[[], None]:
        report, done = self.start_step(until), 0

        def advance() -> None:
            nonlocal done
            done += 1
            report(min(done, self._photos * passes), self._photos * passes)

        return advance

    def report_unchanged(self, done: int, total: int) -> None:  # noqa: ARG002
        self._progress(round(1000 * self._done), 1000)


def _measure_shift(corrections: Sequence[PhotoCorrection], photos: Photos) -> float:
    widths = np.array([camera.width for camera in photos.cameras])
    means = [np.linalg.norm(one.shifts.astype(np.float32), axis=2).mean() for one in corrections]
    return float(np.median(np.array(means) / widths))


def _measure_residual_exposure(corrections: Sequence[PhotoCorrection]) -> float:
    means = [np.abs(to_levels(one.exposure)).mean() for one in corrections if one.exposure is not None]
    return float(np.median(means)) if means else 0.0


def _survey_and_lay_out(
    mesh: Mesh,
    render_mesh: RenderMesh,
    normals: NDArray[np.float64],
    photos: Photos,
    params: TextureParams,
    splitter: _ProgressSplitter,
) -> tuple[Photos, Exposures, list[NDArray[np.uint32]], AtlasLayout, float]:
    """Survey the photos, reject bad ones and lay out the images.

    The survey is released on return, because it takes as much memory as a batch of painting.

    Returns
    -------
    Accepted photos, their exposures, the mesh parts that each may show, the atlas, and the ratio of the
    surface that photos show.
    """
    surveyed = survey_photos(
        mesh, render_mesh, normals, photos, params.views, splitter.start_photo_step(0.25)
    )
    # Run in parallel: the layout is a kernel on one core, the other part is NumPy.
    (accepted, exposures, parts), pages = run_concurrently(
        lambda: reject_inconsistent_photos(surveyed, photos, params.exposure),
        lambda: lay_out_by_density(
            mesh,
            surveyed.pixels_per_m * np.float32(params.texels_per_pixel),
            curve_positions=render_mesh.parts,
            max_side=params.max_size,
            max_texels=params.max_texels * 1e6,
            padding=params.padding,
            progress=splitter.report_unchanged,
        ),
    )
    return accepted, exposures, parts, pages, surveyed.coverage_ratio


def _collect_levels(
    painted: Iterable[PaintedImage], finish: Callable[[PaintedImage], _FinishedImage], *, keep: bool
) -> tuple[list[NDArray[np.uint8]], list[PaintedImage], list[_FinishedImage]]:
    """Collect the levels of all images, and the images themselves, raw or finished.

    Several raw images do not fit into memory. Finishing them immediately is faster than painting them again.
    """
    levels: list[NDArray[np.uint8]] = []
    kept: list[PaintedImage] = []
    finished: list[_FinishedImage] = []
    for one in painted:
        levels.append(quantize_levels(one))
        if keep:
            kept.append(one)
        else:
            finished.append(finish(one))
        # Release the image before the next one is painted.
        del one
    return levels, kept, finished


class _FinishedImage(NamedTuple):
    """Finished image: encoded file and per-texel statistics; see `PaintedImage`."""

    data: bytes
    labels: NDArray[np.int32]
    view_counts: NDArray[np.uint8]
    filled_count: int


def _finish_image(
    painted: PaintedImage, padding: int, params: TextureParams, seams: SeamStatistics
) -> _FinishedImage:
    release_free_memory()
    data, _ = run_concurrently(
        lambda: encode_image(
            fill_gaps_smoothly(painted.colors, painted.is_filled, padding), params.format, params.quality
        ),
        lambda: seams.add(painted.colors, painted.labels, painted.neighbour_sums),
    )
    return _FinishedImage(data, painted.labels, painted.view_counts, int(painted.is_filled.sum()))


def _make_result(
    mesh: Mesh, metrics: _TexturingMetrics, pages: AtlasLayout, images: Sequence[_FinishedImage]
) -> TextureResult:
    suffix = {b"\xff\xd8": "jpg", b"\x89P": "png"}.get(images[0].data[:2], "webp")
    materials = tuple(
        Material(
            name=f"photos-{number}",
            image=Image(name=f"photos-{number}.{suffix}", encoded=one.data),
            wrap=("clamp", "clamp"),
            kept=make_unlit_source(),
        )
        for number, one in enumerate(images, 1)
    )
    textured = mesh.with_(colors=None, texture=Texture(pages.uvs, pages.images, materials))
    exposures = metrics.exposures.photos
    gains = np.array([one.gain for one in exposures])
    v = exposures[0].vignette
    views = np.concatenate([one.view_counts[one.labels >= 0] for one in images])
    texels = sum(one.view_counts.size for one in images)
    return TextureResult(
        mesh=textured,
        photos=tuple(frame.name for frame in metrics.photos.frames),
        camera_centers=np.stack([invert_pose(pose)[:3, 3] for pose in metrics.photos.poses]),
        skipped=metrics.photos.skipped,
        sizes=pages.sizes,
        charts=int(pages.charts.max()) + 1,
        filled_ratio=sum(one.filled_count for one in images) / texels,
        texel_size=pages.compute_median_texel_size(),
        coverage_ratio=metrics.coverage_ratio,
        photos_per_texel=float(views.mean()) if len(views) else 0.0,
        difference_before=metrics.exposures.difference_before,
        difference_after=metrics.exposures.difference_after,
        gain_range=(float(gains.min()), float(gains.max())),
        vignette_ratio=1 - v[0] * (1 + v[1] + v[2]),
        shift_ratio=metrics.shift_ratio,
        residual_exposure_levels=metrics.residual_exposure_levels,
        seam_ratio=metrics.seam_ratio,
        seam_ratio_over_photos=metrics.seam_ratio_over_photos,
        labels=tuple(one.labels for one in images),
        photo_counts=tuple(one.view_counts for one in images),
        layout=pages,
    )


def _report(mesh: Mesh, metrics: _TexturingMetrics) -> None:
    """Warn about surface without photos, and about inconsistent photos."""
    unseen = 1 - metrics.coverage_ratio
    if unseen > _WARN_UNSEEN_RATIO:
        emit(
            TEXTURE_SURFACE_UNSEEN.warning(
                "no photo shows {share:.0%} of the surface, which {colors}",
                share=unseen,
                colors="keeps its vertex colours" if mesh.colors is not None else "has no vertex colours",
            )
        )
    if metrics.shift_ratio > _WARN_SHIFT_RATIO:
        emit(
            TEXTURE_PHOTOS_INCONSISTENT.warning(
                "photos are misaligned with the mesh by {share:.1%} of their width on average, which blurs "
                "details; poses or calibration are inaccurate",
                remedy="`scanloom adjust` corrects them.",
                share=metrics.shift_ratio,
            )
        )
    if metrics.exposures.difference_after > _WARN_DIFFERENCE_LEVELS:
        emit(
            TEXTURE_PHOTOS_INCONSISTENT.warning(
                "photos of the same surface differ by {levels:.0f} levels in the median: poses or "
                "calibration are wrong, or objects have moved",
                levels=metrics.exposures.difference_after,
            )
        )
