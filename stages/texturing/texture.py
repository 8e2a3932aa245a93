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
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Where
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.image_bytes import encoded_image
from scanloom.stages.params import check, param, resolve
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import both
from scanloom.stages.scans.model.scan import Frame, Scan, SkippedFrame
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.formats.gltf_materials import shown_as_it_is
from scanloom.stages.surface.memory import give_back
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.texture import Image, Material, Texture
from scanloom.stages.surface.topology import require_area
from scanloom.stages.surface.vertex_normals import vertex_normals
from scanloom.stages.texturing.codes import (
    TEXTURE_PHOTOS_INCONSISTENT,
    TEXTURE_PHOTOS_UNUSABLE,
    TEXTURE_SURFACE_UNSEEN,
)
from scanloom.stages.texturing.exposure import Exposures
from scanloom.stages.texturing.filling import filled_up
from scanloom.stages.texturing.local_exposure import in_levels
from scanloom.stages.texturing.pages import Pages, laid_out
from scanloom.stages.texturing.painting import PASSES, Painted, Painter, Shown, levels_of
from scanloom.stages.texturing.photos import Photos, photos_of
from scanloom.stages.texturing.seams import SeamSums
from scanloom.stages.texturing.survey import judged, survey
from scanloom.stages.texturing.views import Correction, DrawnMesh, drawn_mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import TextureKeywords

RESULT_VERSION = 16

_MIN_SIZE = 64
# Median shift as a ratio of a photo's width, below which photos count as aligned.
_STILL = 0.3 / 640
# Median local exposure correction in levels, below which no seam is visible.
_EVEN = 1.0
# Thresholds of warnings: ratio of the surface that no photo shows, and difference between photos in levels.
_MUCH_UNSEEN = 0.5
_MUCH_DIFFERENCE = 20.0
# Shift as a ratio of a photo's width, above which photos are misaligned enough for a warning.
_MUCH_OFF = 2.0 / 640

_FILE = "Output images"
_HOW = "Blending"


@dataclass(frozen=True, kw_only=True)
class TextureParams:
    """Parameters of texturing from photos: output images and blending."""

    texels_per_pixel: float = param(
        1.15,
        "Texels per pixel along each side, relative to the photo that shows the surface best.",
        group=_FILE,
        low=0.1,
        high=4,
    )
    max_size: int = param(
        4096,
        "Longest side of an image; a power of two. Several images are written if one is not enough.",
        group=_FILE,
        unit="texels",
        low=_MIN_SIZE,
        high=16384,
        common=True,
    )
    max_texels: float = param(
        64.0,
        "Limit of all images together; all texels get larger if more would be needed.",
        group=_FILE,
        unit="million texels",
        low=0.01,
        high=1000,
    )
    format: str = param("jpeg", "File format of the images.", group=_FILE, choices=("jpeg", "webp", "png"))
    quality: int = param(95, "Quality of JPEG and WebP images.", group=_FILE, low=1, high=100)
    padding: int = param(
        4,
        "Texels around each chart that continue its colours; the gap between two charts is twice as wide.",
        group=_FILE,
        unit="texels",
        low=2,
        high=128,
    )
    views: int = param(12, "Maximum number of photos blended at a texel.", group=_HOW, low=1, high=16)
    exposure: bool = param(
        True,
        "Correct exposure differences between photos: gain and bias per photo and channel, one vignette, "
        "and local corrections in each of the `rounds`.",
        group=_HOW,
    )
    rounds: int = param(
        1,
        "Passes that align photos with the texture, by shifts of a few pixels and local exposure "
        "corrections. Skipped if the photos are aligned already.",
        group=_HOW,
        low=0,
        high=10,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.max_size & (self.max_size - 1):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {max_size} texels; it must be a power of two.",
                Where(parameter="max_size"),
                max_size=self.max_size,
            )


@dataclass(frozen=True, eq=False)
class Textured:
    """Mesh textured from photos, with quality metrics.

    Attributes
    ----------
    mesh : with texture images, without vertex colours.
    photos : names of the frames that were used.
    places : (k, 3) camera centres of these frames, metres.
    skipped : frames that were not used, and the reason.
    sizes : (width, height) of each image, texels.
    charts : number of charts.
    filled : ratio of the images that shows the surface.
    texel_size : median size of a texel on the surface, metres.
    seen : ratio of the surface area that at least one photo shows; the rest keeps the vertex colours.
    views : mean number of photos blended per texel.
    difference_before, difference_after : median difference between photos and their mean, in levels, without
        and with exposure correction.
    gains : minimum and maximum gain over photos and channels.
    vignette : ratio of the light lost in the corners.
    shift : median over the photos of their mean shift, as a ratio of the photo's width.
    uneven : median over the photos of their mean local exposure correction, levels.
    seams : mean colour difference (CIE 1976) across seams, relative to other neighbouring texels; None if
        there are too few pairs.
    seams_over_photos : `seams` divided by the same ratio in single photos that show both texels. Photos often
        end at occlusion boundaries; this ratio compensates for that.
    labels : for each image, (h, w) int32, photo with the highest weight; -1 if no photo shows the surface.
    counts : for each image, (h, w) uint8, number of blended photos.
    diagnostics : warnings.
    """

    mesh: Mesh
    photos: tuple[str, ...]
    places: NDArray[np.float64]
    skipped: tuple[SkippedFrame, ...]
    sizes: tuple[tuple[int, int], ...]
    charts: int
    filled: float
    texel_size: float
    seen: float
    views: float
    difference_before: float
    difference_after: float
    gains: tuple[float, float]
    vignette: float
    shift: float
    uneven: float
    seams: float | None
    seams_over_photos: float | None
    labels: tuple[NDArray[np.int32], ...]
    counts: tuple[NDArray[np.uint8], ...]
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return all metrics for JSON, with units in the keys."""
        return {
            "triangles": len(self.mesh.triangles),
            "photos": len(self.photos),
            "frames_skipped": [one.figures() for one in self.skipped],
            "images": [list(size) for size in self.sizes],
            "charts": self.charts,
            "filled_share": self.filled,
            "texel_size_m": self.texel_size,
            "seen_share": self.seen,
            "photos_a_texel": self.views,
            "difference_before_levels": self.difference_before,
            "difference_after_levels": self.difference_after,
            "gain_least": self.gains[0],
            "gain_greatest": self.gains[1],
            "vignette_share": self.vignette,
            "shift_share_of_width": self.shift,
            "uneven_levels": self.uneven,
            "seam_ratio": self.seams,
            "seam_ratio_over_photos": self.seams_over_photos,
        }


def texture(
    mesh: MeshLike,
    frames: Scan | Iterable[Frame],
    params: TextureParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[TextureKeywords],
) -> Textured:
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
        found = _textured(mesh, frames, params, progress)
    return replace(found, diagnostics=tuple(diagnostics))


def _textured(
    mesh: MeshLike, frames: Scan | Iterable[Frame], params: TextureParams, progress: Progress
) -> Textured:
    given = as_mesh(mesh)
    require_area(given, "mesh")
    where = frames.folder if isinstance(frames, Scan) else None
    shown = list(frames.frames if isinstance(frames, Scan) else frames)
    colored = [frame for frame in shown if frame.color is not None]
    if not colored:
        raise InputError(
            TEXTURE_PHOTOS_UNUSABLE,
            "none of the {shown_count} frames has a colour image.",
            where,
            shown_count=len(shown),
        )
    far = _Far(progress, len(colored))
    photos = photos_of(colored, far.within(0.1))
    if not len(photos):
        first = photos.skipped[0]
        raise InputError(
            TEXTURE_PHOTOS_UNUSABLE,
            "none of the {colored_count} photos can be used (frame {first_name}: {reason}).",
            where,
            colored_count=len(colored),
            first_name=first.name,
            reason=first.reason,
        )
    normals = vertex_normals(given)
    drawn = drawn_mesh(given)
    used, exposures, parts, pages, seen = _looked_over(given, drawn, normals, photos, params, far)
    shown_by = Shown(used, exposures.photos, parts)
    painter = Painter(given, drawn, normals, pages, shown_by, params.views, is_made_even=params.exposure)
    rounds = params.rounds
    part = 0.7 / (1 + rounds)
    painted: Iterable[Painted] = painter.paint(None, far.photo(0.25 + part, painter.parts), again=rounds > 0)
    finish = partial(_finished, padding=pages.padding, params=params)
    shift = uneven = 0.0
    for turn in range(rounds):
        seams = SeamSums()
        images, kept, made = _levels(painted, partial(finish, seams=seams), keep=len(pages.sizes) == 1)
        corrections = painter.corrections(images, far.photo(0.25 + part * (turn + 1.3)))
        del images
        # Only the first corrections measure the misalignment of the original photos.
        shift, uneven = shift or _shift(corrections, used), uneven or _unevenness(corrections)
        if shift < _STILL and uneven < _EVEN:
            if painter.can_add_details:
                seams = SeamSums()
                kept = [painter.with_details(kept[0], far.photo(1.0, PASSES))]
            made = made or [finish(one, seams=seams) for one in kept]
            break
        del kept, made
        done = far.photo(0.25 + part * (turn + 2), painter.parts)
        painted = painter.paint(corrections, done, again=turn + 1 < rounds)
    else:
        seams = SeamSums()
        # No variable keeps an image while the next one is painted.
        made = list(map(partial(finish, seams=seams), painted))
    progress(1000, 1000)
    found = _Found(used, exposures, seen, shift, uneven, seams.ratio(), seams.over_photos())
    _report(given, found)
    return _result(given, found, pages, made)


@dataclass(frozen=True, eq=False)
class _Found:
    """Intermediate results of texturing; see `Textured`."""

    photos: Photos
    exposures: Exposures
    seen: float
    shift: float
    uneven: float
    seams: float | None
    seams_over_photos: float | None


class _Far:
    """Overall progress in thousandths, composed of consecutive work steps.

    Each step advances from the current state to a ratio of all work.
    """

    def __init__(self, progress: Progress, photos: int) -> None:
        self._progress, self._photos, self._done = progress, photos, 0.0

    def within(self, until: float) -> Progress:
        start = self._done
        self._done = until

        def tell(done: int, total: int) -> None:
            self._progress(round(1000 * (start + (until - start) * done / max(total, 1))), 1000)

        return tell

    def photo(self, until: float, times: int = 1) -> Callable[[], None]:
        tell, done = self.within(until), 0

        def one_more() -> None:
            nonlocal done
            done += 1
            tell(min(done, self._photos * times), self._photos * times)

        return one_more

    def nothing(self, done: int, total: int) -> None:  # noqa: ARG002
        self._progress(round(1000 * self._done), 1000)


def _shift(corrections: Sequence[Correction], photos: Photos) -> float:
    widths = np.array([camera.width for camera in photos.cameras])
    means = [np.linalg.norm(one.shifts.astype(np.float32), axis=2).mean() for one in corrections]
    return float(np.median(np.array(means) / widths))


def _unevenness(corrections: Sequence[Correction]) -> float:
    means = [np.abs(in_levels(one.exposure)).mean() for one in corrections if one.exposure is not None]
    return float(np.median(means)) if means else 0.0


def _looked_over(
    mesh: Mesh,
    drawn: DrawnMesh,
    normals: NDArray[np.float64],
    photos: Photos,
    params: TextureParams,
    far: _Far,
) -> tuple[Photos, Exposures, list[NDArray[np.uint32]], Pages, float]:
    """Survey the photos, reject bad ones and lay out the images.

    The survey is released on return, because it takes as much memory as a batch of painting.

    Returns
    -------
    Accepted photos, their exposures, the mesh parts that each may show, the atlas, and the ratio of the
    surface that photos show.
    """
    surveyed = survey(mesh, drawn, normals, photos, params.views, far.photo(0.25))
    # Run in parallel: the layout is a kernel on one core, the other part is NumPy.
    (used, exposures, parts), pages = both(
        lambda: judged(surveyed, photos, params.exposure),
        lambda: laid_out(
            mesh,
            surveyed.pixels_per_m * np.float32(params.texels_per_pixel),
            places=drawn.parts,
            max_side=params.max_size,
            max_texels=params.max_texels * 1e6,
            padding=params.padding,
            progress=far.nothing,
        ),
    )
    return used, exposures, parts, pages, surveyed.seen


def _levels(
    painted: Iterable[Painted], finish: Callable[[Painted], _Image], *, keep: bool
) -> tuple[list[NDArray[np.uint8]], list[Painted], list[_Image]]:
    """Collect the levels of all images, and the images themselves, raw or finished.

    Several raw images do not fit into memory. Finishing them immediately is faster than painting them again.
    """
    levels: list[NDArray[np.uint8]] = []
    kept: list[Painted] = []
    finished: list[_Image] = []
    for one in painted:
        levels.append(levels_of(one))
        if keep:
            kept.append(one)
        else:
            finished.append(finish(one))
        # Release the image before the next one is painted.
        del one
    return levels, kept, finished


class _Image(NamedTuple):
    """Finished image: encoded file and per-texel statistics; see `Painted`."""

    data: bytes
    labels: NDArray[np.int32]
    views: NDArray[np.uint8]
    filled: int


def _finished(painted: Painted, padding: int, params: TextureParams, seams: SeamSums) -> _Image:
    give_back()
    data, _ = both(
        lambda: encoded_image(
            filled_up(painted.colors, painted.filled, padding), params.format, params.quality
        ),
        lambda: seams.add(painted.colors, painted.labels, painted.beside),
    )
    return _Image(data, painted.labels, painted.views, int(painted.filled.sum()))


def _result(mesh: Mesh, found: _Found, pages: Pages, images: Sequence[_Image]) -> Textured:
    suffix = {b"\xff\xd8": "jpg", b"\x89P": "png"}.get(images[0].data[:2], "webp")
    materials = tuple(
        Material(
            name=f"photos-{number}",
            image=Image(name=f"photos-{number}.{suffix}", encoded=one.data),
            wrap=("clamp", "clamp"),
            kept=shown_as_it_is(),
        )
        for number, one in enumerate(images, 1)
    )
    textured = mesh.with_(colors=None, texture=Texture(pages.uvs, pages.images, materials))
    exposures = found.exposures.photos
    gains = np.array([one.gain for one in exposures])
    v = exposures[0].vignette
    views = np.concatenate([one.views[one.labels >= 0] for one in images])
    texels = sum(one.views.size for one in images)
    return Textured(
        mesh=textured,
        photos=tuple(frame.name for frame in found.photos.frames),
        places=np.stack([inverted(pose)[:3, 3] for pose in found.photos.poses]),
        skipped=found.photos.skipped,
        sizes=pages.sizes,
        charts=int(pages.charts.max()) + 1,
        filled=sum(one.filled for one in images) / texels,
        texel_size=pages.usual_texel_size(),
        seen=found.seen,
        views=float(views.mean()) if len(views) else 0.0,
        difference_before=found.exposures.before,
        difference_after=found.exposures.after,
        gains=(float(gains.min()), float(gains.max())),
        vignette=1 - v[0] * (1 + v[1] + v[2]),
        shift=found.shift,
        uneven=found.uneven,
        seams=found.seams,
        seams_over_photos=found.seams_over_photos,
        labels=tuple(one.labels for one in images),
        counts=tuple(one.views for one in images),
    )


def _report(mesh: Mesh, found: _Found) -> None:
    """Warn about surface without photos, and about inconsistent photos."""
    unseen = 1 - found.seen
    if unseen > _MUCH_UNSEEN:
        emit(
            TEXTURE_SURFACE_UNSEEN.warning(
                "no photo shows {share:.0%} of the surface, which {colors}",
                share=unseen,
                colors="keeps its vertex colours" if mesh.colors is not None else "has no vertex colours",
            )
        )
    if found.shift > _MUCH_OFF:
        emit(
            TEXTURE_PHOTOS_INCONSISTENT.warning(
                "photos are misaligned with the mesh by {share:.1%} of their width on average, which blurs "
                "details; poses or calibration are inaccurate",
                remedy="`scanloom adjust` corrects them.",
                share=found.shift,
            )
        )
    if found.exposures.after > _MUCH_DIFFERENCE:
        emit(
            TEXTURE_PHOTOS_INCONSISTENT.warning(
                "photos of the same surface differ by {levels:.0f} levels in the median: poses or "
                "calibration are wrong, or objects have moved",
                levels=found.exposures.after,
            )
        )
