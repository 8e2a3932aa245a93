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
from scanloom.stages.comparing.mesh_rendering import (
    Levels,
    MeshRendering,
    fit_gain_and_bias,
    render_from_pose,
)
from scanloom.stages.comparing.photo_localization import estimate_shutter_rotation, generate_pose_candidates
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.codes import SCAN_FRAMES_SKIPPED
from scanloom.stages.scans.model.images import read_depth, read_photo
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose, SkippedFrame, scale_camera
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface

RESULT_VERSION = 4

# Depth tolerance, as ratio of the depth plus metres; a larger difference means another surface.
_DEPTH_TOLERANCE_RATIO, _DEPTH_TOLERANCE_M = 0.01, 0.04
# Minimum number of mesh pixels in a photo. A pose whose coverage is below this ratio of the best pose's
# coverage is rejected.
_MIN_MESH_PIXELS, _MIN_COVERAGE_RATIO = 500, 0.9
# Standard deviations in pixels: SSIM window, and blur before the gradient energy.
_SSIM_SIGMA_PX, _GRADIENT_SIGMA_PX = 1.5, 0.7
_EROSION_PX = 7
# Pixels, longest side. Larger photos are localised at this size, but scored at full size.
_MAX_LOCALIZATION_SIDE_PX = 1600


@dataclass(frozen=True)
class PhotoScore:
    """Image metrics of one photo against the rendered mesh.

    Attributes
    ----------
    frame_index : index of the frame in the input.
    raw, affine : PSNR in dB, without fit, and after fitting a gain and bias per channel.
    ssim : structural similarity (Wang et al. 2004), mean over the pixels, after the affine fit.
    sharpness : gradient energy of the rendering relative to the photo, after the affine fit.
    coverage : ratio of the photo's pixels that count.
    is_localized : True if the localised pose was used instead of the given one.
    """

    frame_index: int
    raw: float
    affine: float
    ssim: float
    sharpness: float
    coverage: float
    is_localized: bool


@dataclass(frozen=True, eq=False)
class HeldOutEvaluation:
    """Image metrics of held-out photos against a mesh.

    Attributes
    ----------
    scores : one entry per photo that could be evaluated.
    comparison_images : "worst" and "median" photo by affine PSNR, photo and rendering side by side, (h, 2w,
        3) uint8.
    skipped : frames that could not be evaluated, with the reason.
    """

    scores: tuple[PhotoScore, ...]
    comparison_images: dict[str, ColorImage]
    skipped: tuple[SkippedFrame, ...]

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return mean scores and the scores of each photo for JSON."""
        names = {
            "psnr_raw_db": "raw",
            "psnr_affine_db": "affine",
            "ssim": "ssim",
            "sharpness": "sharpness",
            "coverage_ratio": "coverage",
        }
        means = {
            name: float(np.mean([getattr(one, field) for one in self.scores])) if self.scores else None
            for name, field in names.items()
        }
        each = [
            {"place": one.frame_index, **{name: getattr(one, field) for name, field in names.items()}}
            for one in self.scores
        ]
        return {
            "photos": len(self.scores),
            "placed": sum(one.is_localized for one in self.scores),
            **means,
            "each": each,
            "frames_skipped": [one.to_dict() for one in self.skipped],
        }


def evaluate_held_out_photos(
    mesh: Mesh, frames: Sequence[Frame], progress: Progress = ignore_progress
) -> HeldOutEvaluation:
    """Evaluate a mesh against held-out photos.

    Parameters
    ----------
    mesh : mesh with a texture or vertex colours.
    frames : frames with colour images and poses that the mesh was not made from.
    progress : called after each photo.
    """
    surface = RaycastingSurface(mesh)
    scores: list[PhotoScore] = []
    skipped: list[SkippedFrame] = []
    images: list[ColorImage] = []
    for frame_index, frame in enumerate(frames):
        try:
            score, picture = _evaluate_photo(frame_index, frame, surface)
        except InputError as error:
            skipped.append(SkippedFrame(frame.name, error.diagnostic))
        else:
            scores.append(score)
            images.append(picture)
        progress(frame_index + 1, len(frames))
    order = sorted(range(len(scores)), key=lambda i: (scores[i].affine, i))
    pictures = {"worst": images[order[0]], "median": images[order[len(order) // 2]]} if order else {}
    return HeldOutEvaluation(tuple(scores), pictures, tuple(skipped))


def _evaluate_photo(
    frame_index: int, frame: Frame, surface: RaycastingSurface
) -> tuple[PhotoScore, ColorImage]:
    image, camera, shown = read_photo(frame)
    if frame.world_from_camera is None:
        raise InputError(SCAN_FRAMES_SKIPPED, "there is no camera pose.")
    photo_from_frame = (
        np.eye(4) if frame.color_from_depth is None else np.asarray(frame.color_from_depth, np.float64)
    )
    initial_pose = np.asarray(frame.world_from_camera, np.float64) @ invert_pose(photo_from_frame)
    if frame.shutter_turn is not None:
        frame = _estimate_frame_rotation(frame, initial_pose, photo_from_frame, surface)
        image, camera, shown = read_photo(frame)
    photo = _HeldOutPhoto(image, camera, shown)
    small = photo.limit_size(_MAX_LOCALIZATION_SIDE_PX)
    found: list[tuple[PhotoScore, ColorImage, Pose]] = []
    for pose in generate_pose_candidates(small.image, small.camera, initial_pose, surface):
        judged = _score_pose(
            frame_index, small, surface, frame, pose, photo_from_frame, is_localized=pose is not initial_pose
        )
        if judged is not None:
            found.append((*judged, pose))
    if not found:
        raise InputError(TEXTURE_PHOTOS_MISMATCH, "the photo does not show the mesh.")
    # A wrong pose can match a small part of the photo well, so poses with low coverage are rejected.
    min_coverage = _MIN_COVERAGE_RATIO * max(score.coverage for score, *_ in found)
    score, drawn, pose = max(
        (one for one in found if one[0].coverage >= min_coverage),
        key=lambda one: (one[0].affine, not one[0].is_localized),
    )
    full_size = None
    if small is not photo:
        full_size = _score_pose(
            frame_index, photo, surface, frame, pose, photo_from_frame, is_localized=score.is_localized
        )
    return (
        (score, np.hstack([small.image, drawn]))
        if full_size is None
        else (full_size[0], np.hstack([image, full_size[1]]))
    )


@dataclass(frozen=True, eq=False)
class _HeldOutPhoto:
    """Undistorted photo with an optional mask of the valid pixels."""

    image: ColorImage
    camera: Camera
    valid_mask: NDArray[np.bool_] | None

    def limit_size(self, max_side_px: int) -> _HeldOutPhoto:
        """Downscale the photo so that no side exceeds `max_side_px` pixels.

        A photo that is small enough is returned unchanged.
        """
        import cv2

        width, height = self.camera.width, self.camera.height
        if max(width, height) <= max_side_px:
            return self
        share = max_side_px / max(width, height)
        size = max(round(width * share), 1), max(round(height * share), 1)
        shown = self.valid_mask
        if shown is not None:
            shown = cv2.resize(shown.astype(np.uint8), size, interpolation=cv2.INTER_NEAREST) > 0
        image = np.asarray(cv2.resize(self.image, size, interpolation=cv2.INTER_AREA), np.uint8)
        return _HeldOutPhoto(image, scale_camera(self.camera, *size), shown)


def _score_pose(
    frame_index: int,
    photo: _HeldOutPhoto,
    surface: RaycastingSurface,
    frame: Frame,
    pose: Pose,
    photo_from_frame: Pose,
    *,
    is_localized: bool,
) -> tuple[PhotoScore, ColorImage] | None:
    """Score a photo against the mesh rendered from a camera pose.

    Parameters
    ----------
    pose : world_from_camera of the photo's camera.
    photo_from_frame : (4, 4) transform from the frame's camera to the photo's camera.

    Returns
    -------
    The score and the rendered image (h, w, 3) uint8; None if too little of the mesh is visible.
    """
    seen = render_from_pose(surface, photo.camera, pose)
    counted = _mask_depth_consistent(seen, replace(frame, world_from_camera=pose @ photo_from_frame))
    counted = counted if photo.valid_mask is None else counted & photo.valid_mask
    if np.count_nonzero(counted) < _MIN_MESH_PIXELS:
        return None
    drawn = np.where(seen.hit_mask[..., None], seen.levels, 0).clip(0, 255).astype(np.uint8)
    return _score_pixels(frame_index, seen.levels, photo.image, counted, is_localized=is_localized), drawn


def _estimate_frame_rotation(
    frame: Frame, initial_pose: Pose, photo_from_frame: Pose, surface: RaycastingSurface
) -> Frame:
    """Estimate the rolling-shutter rotation of a frame from photo and mesh.

    Returns the frame with the estimate, or without any rotation if the estimate fails.
    """
    frame = replace(frame, shutter_turn=None)
    image, camera, _ = read_photo(frame)
    *_, nearest = generate_pose_candidates(image, camera, initial_pose, surface)
    turn = estimate_shutter_rotation(image, camera, nearest, surface)
    return frame if turn is None else replace(frame, shutter_turn=photo_from_frame[:3, :3].T @ turn)


def _mask_depth_consistent(rendering: MeshRendering, frame: Frame) -> NDArray[np.bool_]:
    """Return a mask (h, w) of mesh pixels that agree with measured depth.

    Without a depth map, all mesh pixels are returned.
    """
    import cv2

    try:
        depth = read_depth(frame)
    except InputError:
        depth = None
    if depth is None:
        return rendering.hit_mask
    pose = np.asarray(frame.world_from_camera, np.float64)
    local = (rendering.positions - pose[:3, 3]) @ pose[:3, :3]
    z = np.maximum(local[..., 2], 1e-9)
    column = np.rint(frame.camera.fx * local[..., 0] / z + frame.camera.cx)
    row = np.rint(frame.camera.fy * local[..., 1] / z + frame.camera.cy)
    inside = (
        rendering.hit_mask & (column >= 0) & (row >= 0) & (column < depth.shape[1]) & (row < depth.shape[0])
    )
    measured = np.zeros(z.shape)
    measured[inside] = depth[row[inside].astype(np.int64), column[inside].astype(np.int64)]
    agrees = (
        inside & (measured > 0) & (np.abs(measured - z) < _DEPTH_TOLERANCE_M + _DEPTH_TOLERANCE_RATIO * z)
    )
    # Depth reprojected into another camera has a lattice of holes.
    closed = cv2.morphologyEx(agrees.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    return np.asarray((closed > 0) & rendering.hit_mask)


def _score_pixels(
    frame_index: int, levels: Levels, image: ColorImage, mask: NDArray[np.bool_], *, is_localized: bool
) -> PhotoScore:
    import cv2
    from skimage.metrics import structural_similarity

    photo = image.astype(np.float32)
    raw = np.where(mask[..., None], levels.clip(0, 255), photo)
    affine = np.where(mask[..., None], fit_gain_and_bias(levels, photo, mask), photo)
    inner = cv2.erode(mask.astype(np.uint8), np.ones((_EROSION_PX, _EROSION_PX), np.uint8)) > 0
    inner = inner if np.count_nonzero(inner) > _MIN_MESH_PIXELS // 5 else mask
    _, similar = structural_similarity(  # type: ignore[no-untyped-call]
        affine,
        photo,
        channel_axis=2,
        data_range=255,
        gaussian_weights=True,
        sigma=_SSIM_SIGMA_PX,
        use_sample_covariance=False,
        full=True,
    )
    return PhotoScore(
        frame_index=frame_index,
        raw=_compute_psnr(raw[mask] - photo[mask]),
        affine=_compute_psnr(affine[mask] - photo[mask]),
        ssim=float(similar[inner].mean()),
        sharpness=_measure_gradient_energy(affine, inner) / max(_measure_gradient_energy(photo, inner), 1e-9),
        coverage=float(mask.mean()),
        is_localized=is_localized,
    )


def _compute_psnr(difference: Levels) -> float:
    return float(10 * np.log10(255**2 / max(float(np.mean(difference.astype(np.float64) ** 2)), 1e-9)))


def _measure_gradient_energy(image: Levels, mask: NDArray[np.bool_]) -> float:
    import cv2

    gray = cv2.cvtColor(image.astype(np.float32), cv2.COLOR_RGB2GRAY)
    smooth = cv2.GaussianBlur(gray, (0, 0), _GRADIENT_SIGMA_PX)
    across, down = (cv2.Sobel(smooth, cv2.CV_32F, dx, dy) for dx, dy in ((1, 0), (0, 1)))
    return float(np.mean((across**2 + down**2)[mask], dtype=np.float64))
