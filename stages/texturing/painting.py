"""The texels of a texture painted from photos, and photos brought to where the texture says they are."""

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
# Colours of texels, the photo that counts most, how many count, and see `beside_photos`.
_Part = tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8], Floats]

# Bytes of the texels that are painted at a time: each remembers its best photos.
_AT_ONCE = 530e6
# Of all texels of a texture, up to which they are painted at a time: a second time takes half as long then.
_ALL_AT_ONCE = 1060e6
# Of a texel, and of each of its photos.
_BYTES, _BYTES_A_PHOTO = 45, 12
# Triangles of a mesh that takes no room worth mentioning, what each more takes, and what is left at least.
_FEW_TRIANGLES, _BYTES_A_TRIANGLE, _LEAST_AT_ONCE = 1_000_000, 106, 177e6
# What a photo counts rises with this power of its score, among details and in what is blurred. A higher
# one for details (3 was tried) comes no nearer to photos that were left out, and seams are seen more.
_DETAILS_POWER, _BLURRED_POWER = 1, 1
# Photos that differ from the median by so many deviations, and so many levels, do not count.
_DEVIATIONS, _LEVELS = 5.0, 12.0
# Texels over which a border is felt that photos leave where they end. Over more (40 were tried) left-out
# photos are met no better, nor borders seen less.
_FELT = 12.0
# Pixels of photos in which shifts are looked for: of larger ones these would take hundreds of megabytes each.
_MOST_PIXELS = 1_500_000
# How often what photos show beyond the texture is added to it: after the second time left-out photos are met
# no better.
PASSES = 2
# Every so many texels tell how the mesh's own colours go with those painted.
_EVERY = 7
_LEAST_TEXELS = 100


@dataclass(frozen=True, eq=False)
class Painted:
    """An image of a texture.

    Attributes
    ----------
    colors : (h, w, 3) float32, levels.
    filled : (h, w) whether a texel shows the surface, and has a colour.
    labels : (h, w) int32, the photo that counts most there; -1 where none shows the surface.
    views : (h, w) uint8, photos that count.
    beside : how neighbours differ, and how photos show them, see `beside_photos`; 0 if it is painted again.
    """

    colors: NDArray[np.float32]
    filled: NDArray[np.bool_]
    labels: NDArray[np.int32]
    views: NDArray[np.uint8]
    beside: Floats


def levels_of(painted: Painted) -> NDArray[np.uint8]:
    """Return what photos are brought to: (h, w, 3) levels, 0 where none shows the surface."""
    levels = np.rint(painted.colors)
    np.clip(levels, 1, 255, out=levels)
    levels[painted.labels < 0] = 0
    return levels.astype(np.uint8)


class Shown(NamedTuple):
    """Photos, how bright each is, and which parts of the drawn mesh it may show."""

    photos: Photos
    exposures: Sequence[Exposure]
    parts: Sequence[NDArray[np.uint32]]

    def showing(self, parts: NDArray[np.uint32]) -> list[int]:
        """Return the numbers of the photos that may show some of these parts."""
        wanted = np.zeros(1 + max(int(some.max(initial=0)) for some in (parts, *self.parts)), np.bool_)
        wanted[parts] = True
        return [number for number, some in enumerate(self.parts) if wanted[some].any()]


class Painter:
    """Paints all images of a texture, once, or again with photos corrected."""

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
        # What is painted at once can be painted again without looking for the best photos anew.
        self._remembered: _kernels.SurfacePoints | None = None
        # Found once where there is one image; all of many may not fit into memory.
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
        """Yield one image after the other; `progress` is called for each photo and part of the texels.

        `again` says that all may be painted once more: what that goes quicker by is kept.
        """
        part = partial(self._part, corrections=corrections, progress=progress, again=again)
        for number in range(len(self._pages.sizes)):
            yield self._page(number, part)

    @property
    def can_add_details(self) -> bool:
        """Whether what `with_details` needs was kept: all was painted at a time, to be painted again."""
        return self._remembered is not None

    def with_details(self, painted: Painted, progress: Callable[[], object]) -> Painted:
        """Return the only image with details; `progress` is called `PASSES` times for each photo."""
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
        """Let go what was kept for painting again."""
        self._remembered = None

    def corrections(
        self, images: Sequence[NDArray[np.uint8]], progress: Callable[[], object]
    ) -> list[Correction]:
        """Return what brings each photo to the texture, which `levels_of` gives."""
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
        """Yield what is painted at a time of an image: what few photos show."""
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
            # What nothing is known of takes on the colours around it.
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
        # The last part has left holes.
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
        # What is remembered is painted again.
        blended = self._blended(points, texels, is_last=not again or self._remembered is None)
        if not again:
            # The image that follows takes as much.
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
    """Bring colours (n, 3), in place, to the differences that photos show where others count beside them."""
    points.level(colors, texels.pixels, width=texels.width, reach=_FELT, wanted_threads=0)


def _texels(size: float, kept: int) -> int:
    """Return how many texels take so many bytes, with the photos that are kept of each."""
    return int(size / (_BYTES + _BYTES_A_PHOTO * kept))


def _room_beside(triangles: int) -> float:
    """Return the bytes of texels that are painted at a time, beside which a mesh fits into memory."""
    return max(_AT_ONCE - _BYTES_A_TRIANGLE * max(triangles - _FEW_TRIANGLES, 0), _LEAST_AT_ONCE)


def _parts(pages: Pages, at_once: int) -> int:
    """Return in how many parts several images are painted, about."""
    has_image = pages.pages >= 0
    texels = np.bincount(pages.pages[has_image], np.abs(signed_areas(pages.corners[has_image])))
    return int(np.ceil(texels / at_once).sum())


def _fill_unseen(colors: NDArray[np.float32], unseen: NDArray[np.bool_], texels: Texels, mesh: Mesh) -> None:
    """Give texels that no photo shows the mesh's own colours, as bright as the photos are here."""
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
    """Return the gain and bias that bring levels nearest to others; 1 and 0 where there are too few."""
    if len(a) < _LEAST_TEXELS or float(a.var()) < 1:
        return 1.0, 0.0
    gain = float(np.mean((a - a.mean()) * (b - b.mean())) / a.var())
    return gain, float(b.mean() - gain * a.mean())
