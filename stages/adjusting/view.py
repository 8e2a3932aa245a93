"""Frame prepared for the adjustment: keypoints and filtered depth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import lens_of
from scanloom.stages.adjusting.lens import OPENCV
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.features import detect_keypoints
from scanloom.stages.registration.codes import REGISTER_FRAMES_UNUSABLE
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import Camera, ColorImage, DepthImage, Frame, SkippedFrame

# Maximum width of images; wider ones are downscaled. Transfer errors are in pixels of the downscaled image.
WIDEST = 960
# Maximum width of depth maps, pixels (wider ones are subsampled); maximum number of keypoints per view.
_WIDEST_DEPTH = 640
_POINTS = 1500
# Contrast threshold of SIFT, lower than its default: smooth or blurred surfaces have no stronger keypoints.
_CONTRAST = 0.025
# Maximum relative depth range in a window of 3 × 3 pixels, and minimum number of its pixels with depth.
_SMOOTH, _NEIGHBOURS = 0.04, 3
# Mean grey levels (0 to 255) below which an image is black, and above which it is over-exposed.
_DARK, _BRIGHT = 8.0, 247.0
BLACK, OVER_EXPOSED = "black", "over-exposed"


@dataclass(frozen=True, eq=False)
class View:
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
    is_plain : the lens of the colour camera can be adjusted (no fisheye, at most five coefficients).
    """

    name: str
    pixels: NDArray[np.float32]
    descriptors: NDArray[np.uint8]
    size: tuple[int, int]
    full_size: tuple[int, int]
    depth: DepthImage
    lens: NDArray[np.float64]
    depth_lens: NDArray[np.float64]
    is_plain: bool


def color_camera(frame: Frame) -> Camera:
    """Return the colour camera of a frame; by default the depth camera."""
    return frame.camera if frame.color_camera is None else frame.color_camera


def place_of_color(frame: Frame) -> NDArray[np.float64]:
    """Return color_from_depth (4, 4) of a frame; by default the identity."""
    return np.eye(4) if frame.color_from_depth is None else np.asarray(frame.color_from_depth, np.float64)


def has_one_camera(frames: Sequence[Frame]) -> bool:
    """Check whether all frames share one colour camera with an adjustable lens."""
    first = frames[0]
    camera, place = color_camera(first), place_of_color(first)
    return (
        not camera.fisheye
        and len(camera.distortion) <= OPENCV
        and all(color_camera(frame) == camera for frame in frames)
        and all(np.array_equal(place_of_color(frame), place) for frame in frames)
    )


def read_view(frame: Frame) -> View:
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
        raise InputError(FRAME_IMAGE_MISSING, "there is no depth map.", Where(frame=frame.name))
    camera = color_camera(frame)
    is_plain = not camera.fisheye and len(camera.distortion) <= OPENCV
    color = as_taken(frame) if is_plain else read_color(frame)
    if color is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no colour image.", Where(frame=frame.name))
    grey = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)
    if not _DARK <= grey.mean() <= _BRIGHT:
        what = BLACK if grey.mean() < _DARK else OVER_EXPOSED
        raise InputError(
            REGISTER_FRAMES_UNUSABLE, "its colour image is {what}", Where(frame=frame.name), what=what
        )
    if grey.shape[1] > WIDEST:
        size = (WIDEST, max(round(grey.shape[0] * WIDEST / grey.shape[1]), 1))
        grey = np.asarray(cv2.resize(grey, size, interpolation=cv2.INTER_AREA), np.uint8)
    found = detect_keypoints(grey, _POINTS, contrast=_CONTRAST)
    height, width = grey.shape
    step = max(-(-depth.shape[1] // _WIDEST_DEPTH), 1)
    given = frame.camera
    return View(
        name=frame.name,
        pixels=found.pixels,
        descriptors=found.descriptors,
        size=(width, height),
        full_size=(color.shape[1], color.shape[0]),
        depth=np.ascontiguousarray(_sound(depth)[::step, ::step]),
        lens=lens_of(camera if is_plain else replace(camera, distortion=(), fisheye=False), width, height),
        depth_lens=np.array([given.fx, given.fy, given.cx, given.cy]) / step,
        is_plain=is_plain,
    )


def view_or_none(frame: Frame) -> View | SkippedFrame:
    """Read a frame; return the reason if it is unusable."""
    try:
        return read_view(frame)
    except InputError as error:
        return SkippedFrame(frame.name, error.diagnostic.within(frame=None))


def exposure_of(skipped: SkippedFrame) -> str | None:
    """Return BLACK or OVER_EXPOSED if a frame was skipped for it; else None."""
    diagnostic = skipped.diagnostic
    return str(diagnostic.values["what"]) if diagnostic.code == REGISTER_FRAMES_UNUSABLE.name else None


def as_taken(frame: Frame) -> ColorImage | None:
    """Read the colour image of a frame without undistortion."""
    camera = replace(color_camera(frame), distortion=())
    return read_color(replace(frame, color_camera=camera))


def _sound(depth: DepthImage) -> DepthImage:
    """Average depth over 3 × 3 pixels; 0 where depths disagree."""
    import cv2

    known = (depth > 0).astype(np.float32)
    count = cv2.boxFilter(known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(depth, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    square = np.ones((3, 3), np.uint8)
    farthest = cv2.dilate(depth, square)
    nearest = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), square)
    smooth = (count >= _NEIGHBOURS) & (farthest - nearest < _SMOOTH * farthest)
    return np.where(smooth, total / np.maximum(count, 1), 0).astype(np.float32)
