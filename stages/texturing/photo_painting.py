"""Painting of texture images from photos, and estimation of photo corrections."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.surface.memory_release import release_free_memory
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import compute_signed_areas
from scanloom.stages.texturing.atlas_layout import AtlasLayout, PageTexels, rasterize_texels
from scanloom.stages.texturing.exposure import Exposure
from scanloom.stages.texturing.local_exposure import estimate_local_exposure
from scanloom.stages.texturing.photo_alignment import estimate_shifts, limit_resolution
from scanloom.stages.texturing.photo_sampling import (
    PhotoCorrection,
    RenderMesh,
    render_texture,
    resample_photos,
    resample_with_details,
    sample_photos,
    to_kernel_camera,
)
from scanloom.stages.texturing.photos import Photos
from scanloom.stages.texturing.seam_visibility import sum_neighbour_differences

Floats = NDArray[np.float64]
# Colours of texels, photo with the highest weight, number of blended photos, sums of
# `sum_neighbour_differences`.
_BatchResult = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8], Floats]

# Bytes of the texels that are painted at a time, with their best photos: bounds memory.
_BATCH_BYTES = 530e6
# Bytes up to which all texels of a texture are painted at once. A second pass then takes half the time,
# because view selection is kept.
_SINGLE_BATCH_BYTES = 1060e6
# Bytes per texel, and per photo kept for a texel.
_BYTES_PER_TEXEL, _BYTES_PER_PHOTO = 45, 12
# Triangles whose memory is negligible, bytes of each further triangle, and minimum bytes of texels at a time.
_FREE_TRIANGLES, _BYTES_PER_TRIANGLE, _MIN_BATCH_BYTES = 1_000_000, 106, 177e6
# Exponents of a photo's score in the blending weight, for details and for the blurred image. Higher exponents
# for details (3 was tried) do not reduce the error on held-out photos and make seams more visible.
_DETAILS_EXPONENT, _BLURRED_EXPONENT = 1, 1
# Outlier rejection: photos that differ from the median by more than both limits are ignored, in deviations
# and in levels.
_OUTLIER_DEVIATIONS, _OUTLIER_LEVELS = 5.0, 12.0
# Distance over which levelling fades out from a seam, in texels. Larger values (40 was tried) improve neither
# the error on held-out photos nor the visibility of seams.
_LEVELLING_REACH_TEXELS = 12.0
# Maximum pixels of the images in which shifts are estimated: larger ones take hundreds of megabytes each.
_MAX_CORRECTION_PIXELS = 1_500_000
# Number of back-projection passes. A third pass does not reduce the error on held-out photos.
DETAIL_PASSES = 2
# Every `_TEXEL_STRIDE`th texel is used to match vertex colours to the painted ones; with fewer than
# `_MIN_TEXELS` the vertex colours stay as they are.
_TEXEL_STRIDE = 7
_MIN_TEXELS = 100


@dataclass(frozen=True, eq=False)
class PaintedImage:
    """Painted image of a texture.

    Attributes
    ----------
    colors : (h, w, 3) float32, levels.
    is_filled : (h, w) bool, texels that show the surface and have a colour.
    labels : (h, w) int32, photo with the highest weight; -1 if no photo shows the texel.
    view_counts : (h, w) uint8, number of photos that are blended.
    neighbour_sums : (2, 2), see `sum_neighbour_differences`; 0 if the image will be painted again.
    """

    colors: NDArray[np.float32]
    is_filled: NDArray[np.bool_]
    labels: NDArray[np.int32]
    view_counts: NDArray[np.uint8]
    neighbour_sums: Floats


def quantize_levels(painted: PaintedImage) -> NDArray[np.uint8]:
    """Convert a painted image to 8 bits, (h, w, 3).

    Texels that no photo shows are 0. Painted texels are at least 1, so that renderings can tell them apart.
    """
    levels = np.rint(painted.colors)
    np.clip(levels, 1, 255, out=levels)
    levels[painted.labels < 0] = 0
    return levels.astype(np.uint8)


class PhotoSelection(NamedTuple):
    """Photos with their exposures and the parts of the mesh that each may show."""

    photos: Photos
    exposures: Sequence[Exposure]
    visible_parts: Sequence[NDArray[np.uint32]]

    def find_visible_photos(self, parts: NDArray[np.uint32]) -> list[int]:
        """Return the indices of the photos that may show some mesh parts."""
        wanted = np.zeros(
            1 + max(int(some.max(initial=0)) for some in (parts, *self.visible_parts)), np.bool_
        )
        wanted[parts] = True
        return [number for number, some in enumerate(self.visible_parts) if wanted[some].any()]


class Painter:
    """Painter of all images of a texture, in one or more passes."""

    def __init__(
        self,
        mesh: Mesh,
        render_mesh: RenderMesh,
        normals: Floats,
        pages: AtlasLayout,
        photo_selection: PhotoSelection,
        max_views: int,
        *,
        corrects_exposure: bool,
    ) -> None:
        self._mesh, self._render_mesh, self._normals, self._pages = mesh, render_mesh, normals, pages
        self._photo_selection, self._max_views, self._corrects_exposure = (
            photo_selection,
            max_views,
            corrects_exposure,
        )
        # Points of the previous pass, if all texels fitted into one batch: view selection need not be
        # repeated.
        self._kept_points: _kernels.SurfacePoints | None = None
        # Texels of a single image are rasterised once; the texels of all of several images may not fit into
        # memory.
        self._single_page_texels = rasterize_texels(pages, 0) if len(pages.sizes) == 1 else None
        all_at_once = _count_affordable_texels(_SINGLE_BATCH_BYTES, max_views)
        is_all = self._single_page_texels is not None and len(self._single_page_texels.pixels) <= all_at_once
        self._batch_texels = (
            all_at_once
            if is_all
            else _count_affordable_texels(_compute_texel_memory(len(mesh.triangles)), max_views)
        )
        self.batch_count = (
            _count_batches(pages, self._batch_texels)
            if self._single_page_texels is None
            else math.ceil(len(self._single_page_texels.pixels) / self._batch_texels)
        )

    def paint(
        self,
        corrections: Sequence[PhotoCorrection] | None,
        progress: Callable[[], object],
        *,
        keeps_selection: bool = False,
    ) -> Iterator[PaintedImage]:
        """Yield the images one by one.

        Parameters
        ----------
        corrections : of each photo; None for none.
        progress : called for each photo and batch of texels.
        keeps_selection : keep the view selection if memory allows, because all images may be painted again.
        """
        paint_batch = partial(
            self._paint_batch, corrections=corrections, progress=progress, keeps_selection=keeps_selection
        )
        for number in range(len(self._pages.sizes)):
            yield self._paint_page(number, paint_batch)

    @property
    def can_add_details(self) -> bool:
        """True if all texels were painted at once, so that `paint_details` can be called."""
        return self._kept_points is not None

    def paint_details(self, painted: PaintedImage, progress: Callable[[], object]) -> PaintedImage:
        """Paint the only image again with details recovered by back-projection.

        `progress` is called `DETAIL_PASSES` times for each photo.
        """
        assert self._kept_points is not None
        photos, exposures, _ = self._photo_selection
        textures: list[_kernels.TexturedSurface] = []
        for turn in range(DETAIL_PASSES):
            textures.append(self._make_textured_surface([quantize_levels(painted)]))
            resample_with_details(
                self._kept_points, photos, exposures, textures, self._render_mesh.near_m, progress
            )
            is_last = turn + 1 == DETAIL_PASSES
            painted = self._paint_page(0, partial(self._blend_points, self._kept_points, is_last=is_last))
        self.forget()
        return painted

    def forget(self) -> None:
        """Release the view selection that was kept for repainting."""
        self._kept_points = None

    def estimate_corrections(
        self, images: Sequence[NDArray[np.uint8]], progress: Callable[[], object]
    ) -> list[PhotoCorrection]:
        """Estimate the shifts and local exposure that align each photo with the texture.

        Parameters
        ----------
        images : (h, w, 3) uint8, from `quantize_levels`.
        progress : called after each photo.
        """
        photos, exposures, _ = self._photo_selection
        surface = self._make_textured_surface(images)

        def estimate_correction(number: int) -> PhotoCorrection:
            photo = photos.read(number)
            camera = to_kernel_camera(photo.camera, photo.camera_from_world)
            rendering, mask = render_texture(surface, camera, self._render_mesh.near_m)
            image = exposures[number].correct(photo.image)
            rendering, mask, image = limit_resolution(rendering, mask, image, _MAX_CORRECTION_PIXELS)
            shifts = estimate_shifts(rendering, mask, image)
            exposure = (
                estimate_local_exposure(rendering, mask, image, shifts) if self._corrects_exposure else None
            )
            return PhotoCorrection(shifts * np.float16(photo.camera.width / image.shape[1]), exposure)

        found = []
        for one in map_ordered(
            estimate_correction,
            range(len(photos)),
            threads=get_worker_count(),
            max_pending=photos.max_concurrent,
        ):
            found.append(one)
            progress()
        return found

    def _make_textured_surface(self, images: Sequence[NDArray[np.uint8]]) -> _kernels.TexturedSurface:
        mesh, pages = self._mesh, self._pages
        return _kernels.TexturedSurface(mesh.vertices, mesh.triangles, pages.corners, pages.pages, images)

    def _iterate_batches(self, page: int) -> Iterator[PageTexels]:
        """Yield spatially compact batches of an image's texels, each visible in few photos."""
        texels = (
            rasterize_texels(self._pages, page)
            if self._single_page_texels is None
            else self._single_page_texels
        )
        return texels.split_by_location(self._render_mesh.parts, self._batch_texels)

    def _paint_page(self, number: int, paint_batch: Callable[[PageTexels], _BatchResult]) -> PaintedImage:
        width, height = self._pages.sizes[number]
        colors = np.zeros((height * width, 3), np.float32)
        filled = np.zeros(height * width, np.bool_)
        labels = np.full(height * width, -1, np.int32)
        views = np.zeros(height * width, np.uint8)
        neighbour_sums = np.zeros((2, 2))
        for texels in self._iterate_batches(number):
            pixels = texels.pixels
            colors[pixels], labels[pixels], views[pixels], sums = paint_batch(texels)
            neighbour_sums += sums
            # Texels without a photo or vertex colour are filled from their surroundings later.
            filled[pixels] = (labels[pixels] >= 0) | (self._mesh.colors is not None)
        shape = (height, width)
        return PaintedImage(
            colors.reshape(*shape, 3),
            filled.reshape(shape),
            labels.reshape(shape),
            views.reshape(shape),
            neighbour_sums,
        )

    def _paint_batch(
        self,
        texels: PageTexels,
        corrections: Sequence[PhotoCorrection] | None,
        progress: Callable[[], object],
        keeps_selection: bool,
    ) -> _BatchResult:
        mesh, drawn, (photos, exposures, _) = self._mesh, self._render_mesh, self._photo_selection
        # The previous batch has left fragmented free memory.
        release_free_memory()
        points = self._kept_points
        if points is not None and corrections is not None:
            resample_photos(points, photos, exposures, corrections, progress)
        else:
            points = _kernels.SurfacePoints(
                mesh.vertices,
                self._normals,
                mesh.triangles,
                texels.triangles,
                texels.weights,
                samples_per_point=self._max_views,
            )
            is_kept = keeps_selection and self.batch_count == 1
            numbers = self._photo_selection.find_visible_photos(np.unique(drawn.parts[texels.triangles]))
            sample_photos(
                points,
                drawn,
                photos,
                exposures,
                corrections,
                progress,
                photo_indices=numbers,
                keeps_visibility=is_kept,
            )
            for _ in range(len(photos) - len(numbers)):
                progress()
            self._kept_points = points if is_kept else None
        # Kept points will be painted again.
        blended = self._blend_points(points, texels, is_last=not keeps_selection or self._kept_points is None)
        if not keeps_selection:
            # Release the points before the caller finishes the image, which takes as much memory.
            self._kept_points = None
        return blended

    def _blend_points(
        self, points: _kernels.SurfacePoints, texels: PageTexels, *, is_last: bool
    ) -> _BatchResult:
        colors, labels, views = points.blend(
            blurred=_BLURRED_EXPONENT,
            details=_DETAILS_EXPONENT,
            deviations=_OUTLIER_DEVIATIONS,
            levels=_OUTLIER_LEVELS,
            wanted_threads=0,
        )
        level_seams(points, colors, texels)
        beside = np.zeros((2, 2))
        if is_last:
            beside = sum_neighbour_differences(points, colors, labels, texels.pixels, texels.width)
        _fill_unseen(colors, labels < 0, texels, self._mesh)
        return colors, labels, views, beside


def level_seams(points: _kernels.SurfacePoints, colors: NDArray[np.float32], texels: PageTexels) -> None:
    """Level colours (n, 3) at seams, in place.

    Where the blended photos change between neighbouring texels, the colour difference is replaced by the
    difference that the photos show.
    """
    points.level_seams(
        colors, texels.pixels, width=texels.width, reach=_LEVELLING_REACH_TEXELS, wanted_threads=0
    )


def _count_affordable_texels(byte_limit: float, max_views: int) -> int:
    """Return the number of texels that fit into `byte_limit` bytes."""
    return int(byte_limit / (_BYTES_PER_TEXEL + _BYTES_PER_PHOTO * max_views))


def _compute_texel_memory(triangles: int) -> float:
    """Return the memory for texels painted at a time, bytes."""
    return max(_BATCH_BYTES - _BYTES_PER_TRIANGLE * max(triangles - _FREE_TRIANGLES, 0), _MIN_BATCH_BYTES)


def _count_batches(pages: AtlasLayout, at_once: int) -> int:
    """Estimate the number of batches for painting several images."""
    has_image = pages.pages >= 0
    texels = np.bincount(pages.pages[has_image], np.abs(compute_signed_areas(pages.corners[has_image])))
    return int(np.ceil(texels / at_once).sum())


def _fill_unseen(
    colors: NDArray[np.float32], is_unseen: NDArray[np.bool_], texels: PageTexels, mesh: Mesh
) -> None:
    """Fill texels that no photo shows with vertex colours.

    The vertex colours are adjusted to the brightness of the photos.
    """
    if mesh.colors is None or not is_unseen.any():
        return

    def interpolate_vertex_colors(chosen: NDArray[np.int64]) -> NDArray[np.float32]:
        corners = mesh.colors[mesh.triangles[texels.triangles[chosen]]].astype(np.float32)  # type: ignore[index]
        return np.asarray(np.einsum("nc,ncx->nx", texels.weights[chosen], corners))

    known, missing = np.flatnonzero(~is_unseen)[::_TEXEL_STRIDE], np.flatnonzero(is_unseen)
    unseen_colors, known_colors = interpolate_vertex_colors(missing), interpolate_vertex_colors(known)
    for k in range(3):
        gain, bias = _fit_line(known_colors[:, k], colors[known, k])
        colors[missing, k] = (gain * unseen_colors[:, k] + bias).clip(0, 255)


def _fit_line(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[float, float]:
    """Fit gain and bias from levels `a` to levels `b` by least squares.

    Returns (1, 0) for too few or uniform samples.
    """
    if len(a) < _MIN_TEXELS or float(a.var()) < 1:
        return 1.0, 0.0
    gain = float(np.mean((a - a.mean()) * (b - b.mean())) / a.var())
    return gain, float(b.mean() - gain * a.mean())
