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
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.surface.memory import give_back
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import signed_areas
from scanloom.stages.texturing.alignment import no_larger, shifts_of
from scanloom.stages.texturing.exposure import Exposure
from scanloom.stages.texturing.local_exposure import local_exposure_of
from scanloom.stages.texturing.pages import Pages, Texels, texels_of
from scanloom.stages.texturing.photos import Photos
from scanloom.stages.texturing.seams import beside_photos
from scanloom.stages.texturing.views import (
    Correction,
    DrawnMesh,
    kernel_camera,
    painted_from,
    see,
    see_again,
    see_details,
)

Floats = NDArray[np.float64]
# Colours of texels, photo with the highest weight, number of blended photos, sums of `beside_photos`.
_Part = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8], Floats]

# Bytes of the texels that are painted at a time, with their best photos: bounds memory.
_AT_ONCE = 530e6
# Bytes up to which all texels of a texture are painted at once. A second pass then takes half the time,
# because view selection is kept.
_ALL_AT_ONCE = 1060e6
# Bytes per texel, and per photo kept for a texel.
_BYTES, _BYTES_A_PHOTO = 45, 12
# Triangles whose memory is negligible, bytes of each further triangle, and minimum bytes of texels at a time.
_FEW_TRIANGLES, _BYTES_A_TRIANGLE, _LEAST_AT_ONCE = 1_000_000, 106, 177e6
# Exponents of a photo's score in the blending weight, for details and for the blurred image. Higher exponents
# for details (3 was tried) do not reduce the error on held-out photos and make seams more visible.
_DETAILS_POWER, _BLURRED_POWER = 1, 1
# Outlier rejection: photos that differ from the median by more than both limits are ignored, in deviations
# and in levels.
_DEVIATIONS, _LEVELS = 5.0, 12.0
# Distance over which levelling fades out from a seam, in texels. Larger values (40 was tried) improve neither
# the error on held-out photos nor the visibility of seams.
_FELT = 12.0
# Maximum pixels of the images in which shifts are estimated: larger ones take hundreds of megabytes each.
_MOST_PIXELS = 1_500_000
# Number of back-projection passes. A third pass does not reduce the error on held-out photos.
PASSES = 2
# Every `_EVERY`th texel is used to match vertex colours to the painted ones; with fewer than `_LEAST_TEXELS`
# the vertex colours stay as they are.
_EVERY = 7
_LEAST_TEXELS = 100


@dataclass(frozen=True, eq=False)
class Painted:
    """Painted image of a texture.

    Attributes
    ----------
    colors : (h, w, 3) float32, levels.
    filled : (h, w) bool, texels that show the surface and have a colour.
    labels : (h, w) int32, photo with the highest weight; -1 if no photo shows the texel.
    views : (h, w) uint8, number of photos that are blended.
    beside : (2, 2), see `beside_photos`; 0 if the image will be painted again.
    """

    colors: NDArray[np.float32]
    filled: NDArray[np.bool_]
    labels: NDArray[np.int32]
    views: NDArray[np.uint8]
    beside: Floats


def levels_of(painted: Painted) -> NDArray[np.uint8]:
    """Convert a painted image to 8 bits, (h, w, 3).

    Texels that no photo shows are 0. Painted texels are at least 1, so that renderings can tell them apart.
    """
    levels = np.rint(painted.colors)
    np.clip(levels, 1, 255, out=levels)
    levels[painted.labels < 0] = 0
    return levels.astype(np.uint8)


class Shown(NamedTuple):
    """Photos with their exposures and the parts of the mesh that each may show."""

    photos: Photos
    exposures: Sequence[Exposure]
    parts: Sequence[NDArray[np.uint32]]

    def showing(self, parts: NDArray[np.uint32]) -> list[int]:
        """Return the indices of the photos that may show some mesh parts."""
        wanted = np.zeros(1 + max(int(some.max(initial=0)) for some in (parts, *self.parts)), np.bool_)
        wanted[parts] = True
        return [number for number, some in enumerate(self.parts) if wanted[some].any()]


class Painter:
    """Painter of all images of a texture, in one or more passes."""

    def __init__(
        self,
        mesh: Mesh,
        drawn: DrawnMesh,
        normals: Floats,
        pages: Pages,
        shown: Shown,
        kept: int,
        *,
        is_made_even: bool,
    ) -> None:
        self._mesh, self._drawn, self._normals, self._pages = mesh, drawn, normals, pages
        self._shown, self._kept, self._is_made_even = shown, kept, is_made_even
        # Points of the previous pass, if all texels fitted into one batch: view selection need not be
        # repeated.
        self._remembered: _kernels.SurfacePoints | None = None
        # Texels of a single image are rasterised once; the texels of all of several images may not fit into
        # memory.
        self._only = texels_of(pages, 0) if len(pages.sizes) == 1 else None
        all_at_once = _texels(_ALL_AT_ONCE, kept)
        is_all = self._only is not None and len(self._only.pixels) <= all_at_once
        self._at_once = all_at_once if is_all else _texels(_room_beside(len(mesh.triangles)), kept)
        self.parts = (
            _parts(pages, self._at_once)
            if self._only is None
            else math.ceil(len(self._only.pixels) / self._at_once)
        )

    def paint(
        self, corrections: Sequence[Correction] | None, progress: Callable[[], object], *, again: bool = False
    ) -> Iterator[Painted]:
        """Yield the images one by one.

        Parameters
        ----------
        corrections : of each photo; None for none.
        progress : called for each photo and batch of texels.
        again : keep the view selection if memory allows, because all images may be painted again.
        """
        part = partial(self._part, corrections=corrections, progress=progress, again=again)
        for number in range(len(self._pages.sizes)):
            yield self._page(number, part)

    @property
    def can_add_details(self) -> bool:
        """True if all texels were painted at once, so that `with_details` can be called."""
        return self._remembered is not None

    def with_details(self, painted: Painted, progress: Callable[[], object]) -> Painted:
        """Paint the only image again with details recovered by back-projection.

        `progress` is called `PASSES` times for each photo.
        """
        assert self._remembered is not None
        photos, exposures, _ = self._shown
        textures: list[_kernels.TexturedSurface] = []
        for turn in range(PASSES):
            textures.append(self._surface([levels_of(painted)]))
            see_details(self._remembered, photos, exposures, textures, self._drawn.near, progress)
            is_last = turn + 1 == PASSES
            painted = self._page(0, partial(self._blended, self._remembered, is_last=is_last))
        self.forget()
        return painted

    def forget(self) -> None:
        """Release the view selection kept for painting again."""
        self._remembered = None

    def corrections(
        self, images: Sequence[NDArray[np.uint8]], progress: Callable[[], object]
    ) -> list[Correction]:
        """Estimate the shifts and local exposure that align each photo with the texture.

        Parameters
        ----------
        images : (h, w, 3) uint8, from `levels_of`.
        progress : called after each photo.
        """
        photos, exposures, _ = self._shown
        surface = self._surface(images)

        def correction(number: int) -> Correction:
            photo = photos.read(number)
            camera = kernel_camera(photo.camera, photo.camera_from_world)
            drawn, shown = painted_from(surface, camera, self._drawn.near)
            image = exposures[number].corrected(photo.image)
            drawn, shown, image = no_larger(drawn, shown, image, _MOST_PIXELS)
            shifts = shifts_of(drawn, shown, image)
            exposure = local_exposure_of(drawn, shown, image, shifts) if self._is_made_even else None
            return Correction(shifts * np.float16(photo.camera.width / image.shape[1]), exposure)

        found = []
        for one in read_ahead(correction, range(len(photos)), threads=workers(), ahead=photos.ahead):
            found.append(one)
            progress()
        return found

    def _surface(self, images: Sequence[NDArray[np.uint8]]) -> _kernels.TexturedSurface:
        mesh, pages = self._mesh, self._pages
        return _kernels.TexturedSurface(mesh.vertices, mesh.triangles, pages.corners, pages.pages, images)

    def _texels(self, page: int) -> Iterator[Texels]:
        """Yield spatially compact batches of an image's texels, each visible in few photos."""
        texels = texels_of(self._pages, page) if self._only is None else self._only
        return texels.parts_of(self._drawn.parts, self._at_once)

    def _page(self, number: int, part: Callable[[Texels], _Part]) -> Painted:
        width, height = self._pages.sizes[number]
        colors = np.zeros((height * width, 3), np.float32)
        filled = np.zeros(height * width, np.bool_)
        labels = np.full(height * width, -1, np.int32)
        views = np.zeros(height * width, np.uint8)
        beside = np.zeros((2, 2))
        for texels in self._texels(number):
            at = texels.pixels
            colors[at], labels[at], views[at], sums = part(texels)
            beside += sums
            # Texels without a photo or vertex colour are filled from their surroundings later.
            filled[at] = (labels[at] >= 0) | (self._mesh.colors is not None)
        shape = (height, width)
        return Painted(
            colors.reshape(*shape, 3),
            filled.reshape(shape),
            labels.reshape(shape),
            views.reshape(shape),
            beside,
        )

    def _part(
        self,
        texels: Texels,
        corrections: Sequence[Correction] | None,
        progress: Callable[[], object],
        again: bool,
    ) -> _Part:
        mesh, drawn, (photos, exposures, _) = self._mesh, self._drawn, self._shown
        # The previous batch has left fragmented free memory.
        give_back()
        points = self._remembered
        if points is not None and corrections is not None:
            see_again(points, photos, exposures, corrections, progress)
        else:
            points = _kernels.SurfacePoints(
                mesh.vertices, self._normals, mesh.triangles, texels.triangles, texels.shares, kept=self._kept
            )
            is_kept = again and self.parts == 1
            numbers = self._shown.showing(np.unique(drawn.parts[texels.triangles]))
            see(points, drawn, photos, exposures, corrections, progress, numbers=numbers, remember=is_kept)
            for _ in range(len(photos) - len(numbers)):
                progress()
            self._remembered = points if is_kept else None
        # Kept points will be painted again.
        blended = self._blended(points, texels, is_last=not again or self._remembered is None)
        if not again:
            # Release the points before the caller finishes the image, which takes as much memory.
            self._remembered = None
        return blended

    def _blended(self, points: _kernels.SurfacePoints, texels: Texels, *, is_last: bool) -> _Part:
        colors, labels, views = points.blend(
            blurred=_BLURRED_POWER,
            details=_DETAILS_POWER,
            deviations=_DEVIATIONS,
            levels=_LEVELS,
            wanted_threads=0,
        )
        level_borders(points, colors, texels)
        beside = np.zeros((2, 2))
        if is_last:
            beside = beside_photos(points, colors, labels, texels.pixels, texels.width)
        _fill_unseen(colors, labels < 0, texels, self._mesh)
        return colors, labels, views, beside


def level_borders(points: _kernels.SurfacePoints, colors: NDArray[np.float32], texels: Texels) -> None:
    """Level colours (n, 3) at seams, in place.

    Where the blended photos change between neighbouring texels, the colour difference is replaced by the
    difference that the photos show.
    """
    points.level(colors, texels.pixels, width=texels.width, reach=_FELT, wanted_threads=0)


def _texels(size: float, kept: int) -> int:
    """Return the number of texels that fit into `size` bytes."""
    return int(size / (_BYTES + _BYTES_A_PHOTO * kept))


def _room_beside(triangles: int) -> float:
    """Return the memory for texels painted at a time, bytes."""
    return max(_AT_ONCE - _BYTES_A_TRIANGLE * max(triangles - _FEW_TRIANGLES, 0), _LEAST_AT_ONCE)


def _parts(pages: Pages, at_once: int) -> int:
    """Estimate the number of batches for painting several images."""
    has_image = pages.pages >= 0
    texels = np.bincount(pages.pages[has_image], np.abs(signed_areas(pages.corners[has_image])))
    return int(np.ceil(texels / at_once).sum())


def _fill_unseen(colors: NDArray[np.float32], unseen: NDArray[np.bool_], texels: Texels, mesh: Mesh) -> None:
    """Fill texels that no photo shows with vertex colours.

    The vertex colours are adjusted to the brightness of the photos.
    """
    if mesh.colors is None or not unseen.any():
        return

    def own(chosen: NDArray[np.int64]) -> NDArray[np.float32]:
        corners = mesh.colors[mesh.triangles[texels.triangles[chosen]]].astype(np.float32)  # type: ignore[index]
        return np.asarray(np.einsum("nc,ncx->nx", texels.shares[chosen], corners))

    known, missing = np.flatnonzero(~unseen)[::_EVERY], np.flatnonzero(unseen)
    there, here = own(missing), own(known)
    for k in range(3):
        gain, bias = _line(here[:, k], colors[known, k])
        colors[missing, k] = (gain * there[:, k] + bias).clip(0, 255)


def _line(a: NDArray[np.float32], b: NDArray[np.float32]) -> tuple[float, float]:
    """Fit gain and bias from levels `a` to levels `b` by least squares.

    Returns (1, 0) for too few or uniform samples.
    """
    if len(a) < _LEAST_TEXELS or float(a.var()) < 1:
        return 1.0, 0.0
    gain = float(np.mean((a - a.mean()) * (b - b.mean())) / a.var())
    return gain, float(b.mean() - gain * a.mean())
