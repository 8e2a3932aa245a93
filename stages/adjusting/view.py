"""Frame prepared for the adjustment: keypoints and filtered depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import get_lens_parameters
from scanloom.stages.adjusting.lens import DISTORTION_COEFFICIENT_COUNT
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.features import detect_keypoints
from scanloom.stages.registration.codes import REGISTER_FRAMES_UNUSABLE
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.depth_correction import DepthCorrection
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, SkippedFrame

# Maximum width of images; wider ones are downscaled. Transfer errors are in pixels of the downscaled image.
MAX_WIDTH_PX = 960
# Maximum width of depth maps, pixels (wider ones are subsampled); maximum number of keypoints per view.
_MAX_DEPTH_WIDTH_PX = 640
_MAX_KEYPOINTS = 1500
# Images with at least this many pixels are not doubled for detection: poses are as accurate without it, in a
# fourth of the time.
_MIN_PIXELS_WITHOUT_DOUBLING = 640 * 360
# Contrast threshold of SIFT, lower than its default: smooth or blurred surfaces have no stronger keypoints.
_CONTRAST = 0.025
# Maximum relative depth range in a window of 3 × 3 pixels, and minimum number of its pixels with depth.
_MAX_DEPTH_RANGE_RATIO, _MIN_NEIGHBOURS = 0.04, 3
# Mean grey levels (0 to 255) below which an image is black, and above which it is over-exposed.
_MIN_MEAN_LEVEL, _MAX_MEAN_LEVEL = 8.0, 247.0
BLACK, OVER_EXPOSED = "black", "over-exposed"


@dataclass(frozen=True, eq=False)
class AdjustmentView:
    """Keypoints, depth and cameras of a frame.

    Attributes
    ----------
    name : name of the frame.
    pixels : (n, 2) float32 keypoints, pixels of the downscaled image.
    descriptors : (n, 128) uint8 SIFT descriptors.
    size : (width, height) of the downscaled image.
    full_size : (width, height) of the stored image.
    depth : (h, w) float32 metres, smoothed over 3 × 3 pixels; 0 where missing or at discontinuities.
    lens : (9,) colour camera as given, see `Cameras.lenses`.
    depth_lens : (4,) fx, fy, cx, cy of the depth map.
    has_adjustable_lens : the lens of the colour camera can be adjusted (no fisheye, at most five
        coefficients).
    depth_step : pixels of the stored depth map per pixel of `depth`.
    depth_correction : correction applied where `depth` is looked up; None without.
    """

    name: str
    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    size: tuple[int, int]
    full_size: tuple[int, int]
    depth: DepthImage
    lens: NDArray[np.float64]
    depth_lens: NDArray[np.float64]
    has_adjustable_lens: bool
    depth_step: int = 1
    depth_correction: DepthCorrection | None = None

    @property
    def full_depth_size(self) -> tuple[int, int]:
        """Return width and height of the stored depth map, pixels; rounded up to whole steps."""
        height, width = self.depth.shape
        return width * self.depth_step, height * self.depth_step


def correct_views(views: Sequence[AdjustmentView], coefficients: NDArray[np.float64]) -> list[AdjustmentView]:
    """Return views whose depth correction has these coefficients (d,)."""
    correction = views[0].depth_correction
    assert correction is not None
    changed = replace(correction, coefficients=tuple(map(float, coefficients)))
    return [replace(view, depth_correction=changed) for view in views]


def get_color_camera(frame: Frame) -> Camera:
    """Return the colour camera of a frame; by default the depth camera."""
    return frame.camera if frame.color_camera is None else frame.color_camera


def get_color_from_depth(frame: Frame) -> NDArray[np.float64]:
    """Return color_from_depth (4, 4) of a frame; by default the identity."""
    return np.eye(4) if frame.color_from_depth is None else np.asarray(frame.color_from_depth, np.float64)


def has_common_color_camera(frames: Sequence[Frame]) -> bool:
    """Check whether all frames share one colour camera with an adjustable lens."""
    first = frames[0]
    camera, place = get_color_camera(first), get_color_from_depth(first)
    return (
        not camera.fisheye
        and len(camera.distortion) <= DISTORTION_COEFFICIENT_COUNT
        and all(get_color_camera(frame) == camera for frame in frames)
        and all(np.array_equal(get_color_from_depth(frame), place) for frame in frames)
    )


def read_adjustment_view(frame: Frame) -> AdjustmentView:
    """Read a frame, detect its keypoints and filter its depth.

    Raises
    ------
    InputError
        If the frame has no colour or depth, cannot be read, or its image is black or over-exposed.
    """
    import cv2

    # Images are read without rolling-shutter correction, because the adjustment models the readout itself.
    frame = replace(frame, shutter_turn=None)
    depth = read_depth(frame)
    if depth is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", DiagnosticLocation(frame=frame.name))
    camera = get_color_camera(frame)
    is_plain = not camera.fisheye and len(camera.distortion) <= DISTORTION_COEFFICIENT_COUNT
    color = read_distorted_color(frame) if is_plain else read_color(frame)
    if color is None:
        raise InputError(
            FRAME_IMAGE_MISSING, "there is no colour image.", DiagnosticLocation(frame=frame.name)
        )
    grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)
    if not _MIN_MEAN_LEVEL <= grey.mean() <= _MAX_MEAN_LEVEL:
        what = BLACK if grey.mean() < _MIN_MEAN_LEVEL else OVER_EXPOSED
        raise InputError(
            REGISTER_FRAMES_UNUSABLE,
            "its colour image is {what}",
            DiagnosticLocation(frame=frame.name),
            what=what,
        )
    if grey.shape[1] > MAX_WIDTH_PX:
        size = (MAX_WIDTH_PX, max(round(grey.shape[0] * MAX_WIDTH_PX / grey.shape[1]), 1))
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    height, width = grey.shape
    is_doubled = width * height < _MIN_PIXELS_WITHOUT_DOUBLING
    found = detect_keypoints(grey, _MAX_KEYPOINTS, contrast=_CONTRAST, is_doubled=is_doubled)
    step = max(-(-depth.shape[1] // _MAX_DEPTH_WIDTH_PX), 1)
    given = frame.camera
    return AdjustmentView(
        name=frame.name,
        pixels=found.pixels,
        descriptors=found.descriptors,
        size=(width, height),
        full_size=(color.shape[1], color.shape[0]),
        depth=np.ascontiguousarray(_smooth_depth(depth)[::step, ::step]),
        lens=get_lens_parameters(
            camera if is_plain else replace(camera, distortion=(), fisheye=False), width, height
        ),
        depth_lens=np.array([given.fx, given.fy, given.cx, given.cy]) / step,
        has_adjustable_lens=is_plain,
        depth_step=step,
    )


def read_view_or_reason(frame: Frame) -> AdjustmentView | SkippedFrame:
    """Read a frame; return the reason if it is unusable."""
    try:
        return read_adjustment_view(frame)
    except InputError as error:
        return SkippedFrame(frame.name, error.diagnostic.replace_location_fields(frame=None))


def get_exposure_problem(skipped: SkippedFrame) -> str | None:
    """Return BLACK or OVER_EXPOSED if a frame was skipped for it; else None."""
    diagnostic = skipped.diagnostic
    return str(diagnostic.values["what"]) if diagnostic.code == REGISTER_FRAMES_UNUSABLE.name else None


def read_distorted_color(frame: Frame) -> ColorImage | None:
    """Read the colour image of a frame without undistortion."""
    camera = replace(get_color_camera(frame), distortion=())
    return read_color(replace(frame, color_camera=camera))


def _smooth_depth(depth: DepthImage) -> DepthImage:
    """Average depth over 3 × 3 pixels; 0 where depths disagree."""
    import cv2

    known = (depth > 0).astype(np.float32)
    count = cv2.boxFilter(known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(depth, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    square = np.ones((3, 3), np.uint8)
    farthest = cv2.dilate(depth, square)
    nearest = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), square)
    smooth = (count >= _MIN_NEIGHBOURS) & (farthest - nearest < _MAX_DEPTH_RANGE_RATIO * farthest)
    return np.where(smooth, total / np.maximum(count, 1), 0).astype(np.float32)
