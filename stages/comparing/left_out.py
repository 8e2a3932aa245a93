"""Photos that nothing was made from, beside the mesh as their cameras see it.

A photo is first placed against the mesh, for the poses of a scan are off by more than a good texture is:
points recognised in the picture of the mesh say where it was taken (perspective-n-point), then the optical
flow from that picture to the photo does so more precisely. Whichever pose explains it best counts. Only
pixels count that show the mesh, and whose measured depth, where there is one, agrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.codes import TEXTURE_PHOTOS_MISMATCH
from scanloom.stages.comparing.placing import poses_of, turn_seen
from scanloom.stages.comparing.seen import Levels, Seen, fitted, seen_from
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import by_figures, table
from scanloom.stages.progress import Progress, silent
from scanloom.stages.scans.codes import SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.images import read_depth, read_photo
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, SkippedFrame, scaled
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface

RESULT_VERSION = 4

# Depth that differs by more than this share of it, and this many metres, shows something else.
_SAME_SHARE, _SAME_M = 0.01, 0.04
# A photo of fewer pixels of the mesh is not judged, nor a pose from which far fewer count than from another.
_LEAST_PIXELS, _SAME_COVERAGE = 500, 0.9
# Window of SSIM, and blur before gradients are measured, both standard deviations in pixels.
_SSIM_SIGMA, _GRADIENT_SIGMA = 1.5, 0.7
_BORDER = 7
# Where a larger photo was taken is looked for with so many pixels a side at most; it is judged as it is.
_LARGEST_PLACED = 1600


@dataclass(frozen=True)
class Score:
    """How one photo and the mesh from its camera differ.

    Attributes
    ----------
    place : of the frame among those given.
    raw, affine : PSNR in dB, of the levels as they are, and after one gain and bias a channel.
    ssim : structural similarity (Wang et al. 2004), mean over the pixels, after the affine fit.
    sharpness : gradient energy over the photo's, after the affine fit.
    coverage : share of the photo's pixels that count.
    placed : the photo was placed against the mesh.
    """

    place: int
    raw: float
    affine: float
    ssim: float
    sharpness: float
    coverage: float
    placed: bool


@dataclass(frozen=True, eq=False)
class LeftOut:
    """How photos and a mesh differ.

    Attributes
    ----------
    scores : of each photo that could be judged.
    pictures : of the worst and of the median photo by affine PSNR, photo | mesh, (h, 2w, 3) uint8.
    skipped : frames that could not be judged, and why.
    """

    scores: tuple[Score, ...]
    pictures: dict[str, ColorImage]
    skipped: tuple[SkippedFrame, ...]

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return means over the photos, and each one's scores, for JSON."""
        names = {
            "psnr_raw_db": "raw",
            "psnr_affine_db": "affine",
            "ssim": "ssim",
            "sharpness": "sharpness",
            "coverage_share": "coverage",
        }
        means = {
            name: float(np.mean([getattr(one, field) for one in self.scores])) if self.scores else None
            for name, field in names.items()
        }
        each = [
            {"place": one.place, **{name: getattr(one, field) for name, field in names.items()}}
            for one in self.scores
        ]
        return {
            "photos": len(self.scores),
            "placed": sum(one.placed for one in self.scores),
            **means,
            "each": each,
            "frames_skipped": [one.figures() for one in self.skipped],
        }


def left_out(mesh: Mesh, frames: Sequence[Frame], progress: Progress = silent) -> LeftOut:
    """Compare photos with a mesh.

    Parameters
    ----------
    mesh : with a texture or vertex colours.
    frames : with colour and poses, from which the mesh was not made.
    progress : called after each photo.
    """
    surface = Surface(mesh)
    scores: list[Score] = []
    skipped: list[SkippedFrame] = []
    shown: list[ColorImage] = []
    for place, frame in enumerate(frames):
        try:
            score, picture = _judged(place, frame, surface)
        except InputError as error:
            skipped.append(SkippedFrame(frame.name, error.diagnostic))
        else:
            scores.append(score)
            shown.append(picture)
        progress(place + 1, len(frames))
    order = sorted(range(len(scores)), key=lambda i: (scores[i].affine, i))
    pictures = {"worst": shown[order[0]], "median": shown[order[len(order) // 2]]} if order else {}
    return LeftOut(tuple(scores), pictures, tuple(skipped))


def _judged(place: int, frame: Frame, surface: Surface) -> tuple[Score, ColorImage]:
    image, camera, shown = read_photo(frame)
    if frame.world_from_camera is None:
        raise InputError(SCAN_FRAMES_SKIPPED, "there is no camera pose.")
    apart = np.eye(4) if frame.color_from_depth is None else np.asarray(frame.color_from_depth, np.float64)
    given = np.asarray(frame.world_from_camera, np.float64) @ inverted(apart)
    if frame.shutter_turn is not None:
        frame = _with_its_turn(frame, given, apart, surface)
        image, camera, shown = read_photo(frame)
    photo = _Photo(image, camera, shown)
    small = photo.no_larger_than(_LARGEST_PLACED)
    found: list[tuple[Score, ColorImage, Pose]] = []
    for pose in poses_of(small.image, small.camera, given, surface):
        judged = _from_pose(place, small, surface, frame, pose, apart, placed=pose is not given)
        if judged is not None:
            found.append((*judged, pose))
    if not found:
        raise InputError(TEXTURE_PHOTOS_MISMATCH, "its photo does not show the mesh.")
    # A wrong pose may come near to little of the photo.
    least = _SAME_COVERAGE * max(score.coverage for score, *_ in found)
    score, drawn, pose = max(
        (one for one in found if one[0].coverage >= least), key=lambda one: (one[0].affine, not one[0].placed)
    )
    whole = None
    if small is not photo:
        whole = _from_pose(place, photo, surface, frame, pose, apart, placed=score.placed)
    return (
        (score, np.hstack([small.image, drawn]))
        if whole is None
        else (whole[0], np.hstack([image, whole[1]]))
    )


@dataclass(frozen=True, eq=False)
class _Photo:
    """A photo without lens distortion, and which of its pixels count, if not all."""

    image: ColorImage
    camera: Camera
    shown: NDArray[np.bool_] | None

    def no_larger_than(self, side: int) -> _Photo:
        """Return the photo with no side of more pixels: itself, where none is longer."""
        import cv2

        width, height = self.camera.width, self.camera.height
        if max(width, height) <= side:
            return self
        share = side / max(width, height)
        size = max(round(width * share), 1), max(round(height * share), 1)
        shown = self.shown
        if shown is not None:
            shown = cv2.resize(shown.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        image = np.asarray(cv2.resize(self.image, size, interpolation=cv2.INTER_AREA), np.uint8)
        return _Photo(image, scaled(self.camera, *size), shown)


def _from_pose(
    place: int, photo: _Photo, surface: Surface, frame: Frame, pose: Pose, apart: Pose, *, placed: bool
) -> tuple[Score, ColorImage] | None:
    """Return how a photo and the mesh differ from a pose of its camera, and that picture of the mesh.

    None if too little of the mesh is seen from there. `apart` takes points of the frame's camera to the
    photo's.
    """
    seen = seen_from(surface, photo.camera, pose)
    counted = _counted(seen, replace(frame, world_from_camera=pose @ apart))
    counted = counted if photo.shown is None else counted & photo.shown
    if np.count_nonzero(counted) < _LEAST_PIXELS:
        return None
    drawn = np.where(seen.hit[..., None], seen.levels, 0).clip(0, 255).astype(np.uint8)
    return _score(place, seen.levels, photo.image, counted, placed=placed), drawn


def _with_its_turn(frame: Frame, given: Pose, apart: Pose, surface: Surface) -> Frame:
    """Return a frame with how its own camera turned while rows were read, by what it shows of the mesh."""
    frame = replace(frame, shutter_turn=None)
    image, camera, _ = read_photo(frame)
    *_, nearest = poses_of(image, camera, given, surface)
    turn = turn_seen(image, camera, nearest, surface)
    return frame if turn is None else replace(frame, shutter_turn=apart[:3, :3].T @ turn)


def _counted(seen: Seen, frame: Frame) -> NDArray[np.bool_]:
    """Return which pixels show what the depth map of the frame shows, too."""
    import cv2

    try:
        depth = read_depth(frame)
    except InputError:
        depth = None
    if depth is None:
        return seen.hit
    pose = np.asarray(frame.world_from_camera, np.float64)
    local = (seen.places - pose[:3, 3]) @ pose[:3, :3]
    z = np.maximum(local[..., 2], 1e-9)
    column = np.rint(frame.camera.fx * local[..., 0] / z + frame.camera.cx)
    row = np.rint(frame.camera.fy * local[..., 1] / z + frame.camera.cy)
    inside = seen.hit & (column >= 0) & (row >= 0) & (column < depth.shape[1]) & (row < depth.shape[0])
    measured = np.zeros(z.shape)
    measured[inside] = depth[row[inside].astype(np.int64), column[inside].astype(np.int64)]
    agrees = inside & (measured > 0) & (np.abs(measured - z) < _SAME_M + _SAME_SHARE * z)
    # Depth that was brought to another camera has a lattice of holes.
    closed = cv2.morphologyEx(agrees.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return np.asarray((closed > 0) & seen.hit)


def _score(
    place: int, levels: Levels, image: ColorImage, counted: NDArray[np.bool_], *, placed: bool
) -> Score:
    import cv2
    from skimage.metrics import structural_similarity

    photo = image.astype(np.float32)
    raw = np.where(counted[..., None], levels.clip(0, 255), photo)
    affine = np.where(counted[..., None], fitted(levels, photo, counted), photo)
    inner = cv2.erode(counted.astype(np.uint8), np.ones((_BORDER, _BORDER), np.uint8)) > 0
    inner = inner if np.count_nonzero(inner) > _LEAST_PIXELS // 5 else counted
    _, similar = structural_similarity(  # type: ignore[no-untyped-call]
        affine,
        photo,
        channel_axis=2,
        data_range=255,
        gaussian_weights=True,
        sigma=_SSIM_SIGMA,
        use_sample_covariance=False,
        full=True,
    )
    return Score(
        place=place,
        raw=_psnr(raw[counted] - photo[counted]),
        affine=_psnr(affine[counted] - photo[counted]),
        ssim=float(similar[inner].mean()),
        sharpness=_gradient_energy(affine, inner) / max(_gradient_energy(photo, inner), 1e-9),
        coverage=float(counted.mean()),
        placed=placed,
    )


def _psnr(difference: Levels) -> float:
    return float(10 * np.log10(255**2 / max(float(np.mean(difference.astype(np.float64) ** 2)), 1e-9)))


def _gradient_energy(image: Levels, counted: NDArray[np.bool_]) -> float:
    import cv2

    gray = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY)
    smooth = cv2.GaussianBlur(gray, (0, 0), _GRADIENT_SIGMA)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, dx, dy) for dx, dy in ((1, 0), (0, 1)))
    return float(np.mean((across**2 + down**2)[counted], dtype=np.float64))
