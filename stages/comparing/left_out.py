"""Image quality of a textured mesh, measured against held-out photos.

Each photo is first localised against the mesh, because scan poses are less accurate than a good texture.
Feature matches between photo and rendered mesh give a pose (perspective-n-point). Optical flow from the
rendering to the photo refines the pose. Among given, matched and refined pose, the one with the highest PSNR
counts. Only pixels count that show the mesh and whose measured depth, if any, agrees.
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

# Depth tolerance, as ratio of the depth plus metres; a larger difference means another surface.
_SAME_SHARE, _SAME_M = 0.01, 0.04
# Minimum number of mesh pixels in a photo. A pose whose coverage is below this ratio of the best pose's
# coverage is rejected.
_LEAST_PIXELS, _SAME_COVERAGE = 500, 0.9
# Standard deviations in pixels: SSIM window, and blur before the gradient energy.
_SSIM_SIGMA, _GRADIENT_SIGMA = 1.5, 0.7
_BORDER = 7
# Pixels, longest side. Larger photos are localised at this size, but scored at full size.
_LARGEST_PLACED = 1600


@dataclass(frozen=True)
class Score:
    """Image metrics of one photo against the rendered mesh.

    Attributes
    ----------
    place : index of the frame in the input.
    raw, affine : PSNR in dB, without fit, and after fitting a gain and bias per channel.
    ssim : structural similarity (Wang et al. 2004), mean over the pixels, after the affine fit.
    sharpness : gradient energy of the rendering relative to the photo, after the affine fit.
    coverage : ratio of the photo's pixels that count.
    placed : True if the localised pose was used instead of the given one.
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
    """Image metrics of held-out photos against a mesh.

    Attributes
    ----------
    scores : one entry per photo that could be evaluated.
    pictures : "worst" and "median" photo by affine PSNR, photo and rendering side by side, (h, 2w, 3) uint8.
    skipped : frames that could not be evaluated, with the reason.
    """

    scores: tuple[Score, ...]
    pictures: dict[str, ColorImage]
    skipped: tuple[SkippedFrame, ...]

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return mean scores and the scores of each photo for JSON."""
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
    """Evaluate a mesh against held-out photos.

    Parameters
    ----------
    mesh : mesh with a texture or vertex colours.
    frames : frames with colour images and poses that the mesh was not made from.
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
        raise InputError(TEXTURE_PHOTOS_MISMATCH, "the photo does not show the mesh.")
    # A wrong pose can match a small part of the photo well, so poses with low coverage are rejected.
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
    """Undistorted photo with an optional mask of the valid pixels."""

    image: ColorImage
    camera: Camera
    shown: NDArray[np.bool_] | None

    def no_larger_than(self, side: int) -> _Photo:
        """Downscale the photo so that no side exceeds `side` pixels.

        A photo that is small enough is returned unchanged.
        """
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
    """Score a photo against the mesh rendered from a camera pose.

    Parameters
    ----------
    pose : world_from_camera of the photo's camera.
    apart : (4, 4) transform from the frame's camera to the photo's camera.

    Returns
    -------
    The score and the rendered image (h, w, 3) uint8; None if too little of the mesh is visible.
    """
    seen = seen_from(surface, photo.camera, pose)
    counted = _counted(seen, replace(frame, world_from_camera=pose @ apart))
    counted = counted if photo.shown is None else counted & photo.shown
    if np.count_nonzero(counted) < _LEAST_PIXELS:
        return None
    drawn = np.where(seen.hit[..., None], seen.levels, 0).clip(0, 255).astype(np.uint8)
    return _score(place, seen.levels, photo.image, counted, placed=placed), drawn


def _with_its_turn(frame: Frame, given: Pose, apart: Pose, surface: Surface) -> Frame:
    """Estimate the rolling-shutter rotation of a frame from photo and mesh.

    Returns the frame with the estimate, or without any rotation if the estimate fails.
    """
    frame = replace(frame, shutter_turn=None)
    image, camera, _ = read_photo(frame)
    *_, nearest = poses_of(image, camera, given, surface)
    turn = turn_seen(image, camera, nearest, surface)
    return frame if turn is None else replace(frame, shutter_turn=apart[:3, :3].T @ turn)


def _counted(seen: Seen, frame: Frame) -> NDArray[np.bool_]:
    """Return a mask (h, w) of mesh pixels that agree with measured depth.

    Without a depth map, all mesh pixels are returned.
    """
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
    # Depth reprojected into another camera has a lattice of holes.
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
