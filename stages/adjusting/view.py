"""A frame as adjustment needs it: points that can be recognised, and depth that can be relied on."""

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

# Wider images are made smaller; transfer errors are in pixels of what is looked at.
WIDEST = 960
# Wider depth maps are thinned.
_WIDEST_DEPTH = 640
_POINTS = 1500
# Weaker corners count than by default: what is smooth or blurred has no others.
_CONTRAST = 0.025
# Depth among neighbours may differ by this share of it; fewer neighbours than this say nothing.
_SMOOTH, _NEIGHBOURS = 0.04, 3
# A grey image is black or white where its mean is beyond these.
_DARK, _BRIGHT = 8.0, 247.0
BLACK, OVER_EXPOSED = "black", "over-exposed"


@dataclass(frozen=True, eq=False)
class View:
    """A frame that was read.

    Attributes
    ----------
    name : of the frame.
    pixels : (n, 2) float32, of recognisable points, in the image that was looked at.
    descriptors : (n, 128) uint8, SIFT's.
    size : (width, height) of that image.
    full_size : of the image as it is stored.
    depth : (h, w) float32 metres, 0 where it is missing or jumps; a mean of neighbours elsewhere.
    lens : (9,) of the colour camera as given, see `Cameras.lenses`.
    depth_lens : (4,) fx, fy, cx, cy of the depth map.
    is_plain : the colour camera's lens is one that can be adjusted.
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
    """Return the camera of a frame's colour image, that of its depth map where none is stated."""
    return frame.camera if frame.color_camera is None else frame.color_camera


def place_of_color(frame: Frame) -> NDArray[np.float64]:
    """Return (4, 4) color_from_depth, that of one place where none is stated."""
    return np.eye(4) if frame.color_from_depth is None else np.asarray(frame.color_from_depth, np.float64)


def has_one_camera(frames: Sequence[Frame]) -> bool:
    """Say whether one colour camera took all photos, of a lens that can be adjusted."""
    first = frames[0]
    camera, place = color_camera(first), place_of_color(first)
    return (
        not camera.fisheye
        and len(camera.distortion) <= OPENCV
        and all(color_camera(frame) == camera for frame in frames)
        and all(np.array_equal(place_of_color(frame), place) for frame in frames)
    )


def read_view(frame: Frame) -> View:
    """Read a frame.

    Raises
    ------
    InputError
        If it has no colour or depth, cannot be read, or its image is black or over-exposed.
    """
    import cv2

    # Rows that are read one after the other are where they were read.
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
    """Return what is read of a frame, or why it cannot be used."""
    try:
        return read_view(frame)
    except InputError as error:
        return SkippedFrame(frame.name, error.diagnostic.within(frame=None))


def exposure_of(skipped: SkippedFrame) -> str | None:
    """Return BLACK or OVER_EXPOSED for a frame that was skipped because of it, else None."""
    diagnostic = skipped.diagnostic
    return str(diagnostic.values["what"]) if diagnostic.code == REGISTER_FRAMES_UNUSABLE.name else None


def as_taken(frame: Frame) -> ColorImage | None:
    """Return the colour image with the distortion of its lens."""
    camera = replace(color_camera(frame), distortion=())
    return read_color(replace(frame, color_camera=camera))


def _sound(depth: DepthImage) -> DepthImage:
    """Return the mean of what each pixel and its neighbours measure, 0 where these do not agree."""
    import cv2

    known = (depth > 0).astype(np.float32)
    count = cv2.boxFilter(known, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    total = cv2.boxFilter(depth, -1, (3, 3), normalize=False, borderType=cv2.BORDER_CONSTANT)
    square = np.ones((3, 3), np.uint8)
    farthest = cv2.dilate(depth, square)
    nearest = cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)), square)
    smooth = (count >= _NEIGHBOURS) & (farthest - nearest < _SMOOTH * farthest)
    return np.where(smooth, total / np.maximum(count, 1), 0).astype(np.float32)
