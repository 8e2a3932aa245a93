"""Photo-guided upsampling of low-resolution depth maps, such as those from phones.

Inverse depth is interpolated between samples of one surface, which is exact on planes.

Next to a depth jump, a vote of the surrounding samples assigns each pixel to one side (joint bilateral
upsampling, Kopf et al. 2007). Samples with the pixel's colour decide if the photo separates both sides there,
else the nearest samples. A plane through the samples of that side gives the depth of the pixel. No depth is
created between two surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.aligned_color import read_color_aligned_to_depth
from scanloom.stages.frames.depth_filter import fill_gaps
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, scale_camera, to_pinhole

Image = NDArray[np.float32]
Indices = NDArray[np.intp]

# Neighbours whose inverse depth differs by more than this ratio are on different surfaces.
_MAX_JUMP_RATIO = 0.03
# Window of voting samples, in each direction.
_WINDOW_RADIUS = 2
# Standard deviations of the Gaussian weights: of a vote and of the plane fit (in samples), and of colour
# differences (grey levels).
_VOTE_SIGMA, _FIT_SIGMA, _COLOR_SIGMA = 1.0, 0.7, 12.0
# The photo separates both sides if the squared difference of their mean colours exceeds this multiple of the
# variance within the sides. The second value is the minimum standard deviation per channel, grey levels.
_MIN_SEPARATION, _MIN_COLOR_DEVIATION = 16.0, 6.0
# Regularisation that pulls slopes to zero where few samples determine them, in samples squared.
_SLOPE_REGULARISATION = 0.15
# Blur of the photo for the colour of a sample, relative to the sample spacing: the footprint of a depth
# sample.
_FOOTPRINT_SIGMA = 0.35
# Batch size of pixels next to jumps, limits memory.
_BATCH_SIZE = 100_000


def upsample_single_frame(frames: Sequence[Frame], params: FuseParams) -> Sequence[Frame]:
    """Upsample the depth of a single frame, if the parameters request it.

    Several frames are returned unchanged: the voxel size of a single frame is derived from the upsampled
    depth, the voxel size of several frames from the measured depth.
    """
    if len(frames) != 1 or params.upsample == "off":
        return frames
    min_width_ratio = params.upsample_factor if params.upsample == "auto" else 0
    try:
        return [upsample_frame(frames[0], params, min_width_ratio)]
    except InputError:
        return frames  # reported where the frame is read


def upsample_frame(frame: Frame, params: FuseParams, min_width_ratio: float = 0.0) -> Frame:
    """Upsample the depth map of a frame.

    The photo of the returned frame is registered to the upsampled depth.

    Parameters
    ----------
    params : `upsample_factor`, and `max_jump` for bridging gaps of one pixel. Upsampling would widen the
        gaps, so they are bridged first.
    min_width_ratio : minimum ratio of photo width to depth map width. Frames below it, and frames without a
        photo, are returned unchanged. 0 upsamples every frame.

    Raises
    ------
    InputError
        If the images cannot be read.
    """
    depth, photo = read_depth(frame), read_color(frame)
    if depth is None or (photo.shape[1] if photo is not None else 0) < min_width_ratio * depth.shape[1]:
        return frame
    depth, _ = fill_gaps(depth, params.max_jump)
    factor, (height, width) = params.upsample_factor, depth.shape
    larger_camera = scale_camera(to_pinhole(frame.camera), factor * width, factor * height)
    # Reading has already applied confidence, mask, rolling shutter and depth correction.
    frame = replace(
        frame,
        camera=larger_camera,
        confidence=None,
        min_confidence=0,
        mask=None,
        shutter_turn=None,
        depth_correction=None,
    )
    if photo is None:
        return replace(frame, depth=upsample_depth(depth, None, factor))
    registered = replace(
        frame,
        color=photo,
        color_camera=None if frame.color_camera is None else to_pinhole(frame.color_camera),
    )
    color = read_color_aligned_to_depth(
        registered, np.repeat(np.repeat(depth, factor, axis=0), factor, axis=1)
    )
    larger = upsample_depth(depth, color, factor)
    return replace(registered, color=color, color_camera=None, color_from_depth=None, depth=larger)


def upsample_depth(depth: DepthImage, color: ColorImage | None, factor: int) -> DepthImage:
    """Upsample a depth map by an integer factor.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    color : (factor · h, factor · w, 3) uint8 RGB, registered to the upsampled depth map; None without a
        photo.

    Returns
    -------
    (factor · h, factor · w) float32 metres; 0 where the nearest sample is missing.

    Raises
    ------
    InputError
        If the size of the colour image does not match.
    """
    import cv2

    height, width = (factor * side for side in depth.shape)
    if color is not None and color.shape[:2] != (height, width):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "the colour image is {color_shape} × {color_shape_2} px; it must be {width} × {height} px.",
            color_shape=color.shape[1],
            color_shape_2=color.shape[0],
            width=width,
            height=height,
        )
    is_valid = depth > 0
    inverse = _invert(depth)
    total, weight = (
        np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
        for image in (inverse, is_valid.astype(np.float32))
    )
    near = np.arange(height) // factor, np.arange(width) // factor
    is_known = is_valid[near[0]][:, near[1]]
    larger = np.where(is_known, total / np.maximum(weight, np.float32(1e-6)), np.float32(0))
    rows, columns = np.nonzero(_mask_jumps(inverse)[near[0]][:, near[1]] & is_known)
    guide = None if color is None else _build_guide(inverse, color, factor)
    for first in range(0, len(rows), _BATCH_SIZE):
        at = rows[first : first + _BATCH_SIZE], columns[first : first + _BATCH_SIZE]
        larger[at] = _estimate_at_jumps(inverse, guide, at, factor)
    return _invert(larger)


@dataclass(frozen=True, eq=False)
class _Guide:
    """Guide image for upsampling by a factor k.

    Attributes
    ----------
    pixels : (h · k, w · k, 3) photo.
    samples : (h, w, 3) photo blurred to the footprint of the depth samples.
    is_separable : (h, w), 1 where colour separates both sides of a depth jump, else 0.
    """

    pixels: Image
    samples: Image
    is_separable: Image


def _build_guide(inverse: Image, color: ColorImage, factor: int) -> _Guide:
    import cv2

    colors = color.astype(np.float32)
    blurred = cv2.GaussianBlur(colors, (0, 0), _FOOTPRINT_SIGMA * factor)
    size = inverse.shape[1], inverse.shape[0]
    samples = np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), np.float32)
    return _Guide(colors, samples, _mark_separable_colors(inverse, samples))


def _invert(image: Image) -> Image:
    return np.asarray(np.divide(1, image, out=np.zeros_like(image), where=image > 0), np.float32)


def _mask_jumps(inverse: Image) -> NDArray[np.bool_]:
    """Return a mask of samples with a depth jump to a neighbour."""
    return np.asarray(
        _find_farthest(inverse, 1) < _find_nearest(inverse, 1) / np.float32(1 + _MAX_JUMP_RATIO)
    )


def _find_nearest(inverse: Image, reach: int) -> Image:
    import cv2

    return np.asarray(cv2.dilate(inverse, np.ones((2 * reach + 1,) * 2, np.uint8)), np.float32)


def _find_farthest(inverse: Image, reach: int) -> Image:
    import cv2

    known = np.where(inverse > 0, inverse, np.float32(np.inf))
    return np.asarray(cv2.erode(known, np.ones((2 * reach + 1,) * 2, np.uint8)), np.float32)


def _mark_separable_colors(inverse: Image, colors: Image) -> Image:
    """Mark samples around which near and far side differ in colour.

    Uses Fisher's criterion.

    Returns
    -------
    (h, w) float32, 1 or 0.
    """
    height, width = inverse.shape
    with np.errstate(invalid="ignore"):
        middle = (_find_nearest(inverse, _WINDOW_RADIUS) + _find_farthest(inverse, _WINDOW_RADIUS)) / 2
    around, seen = _pad(inverse), _pad(colors)
    # Per side (near, far): sample count, sum of colours, and sum of squared colours.
    count, total = np.zeros((2, height, width), np.float32), np.zeros((2, height, width, 3), np.float32)
    squares = np.zeros_like(count)
    for row, column in np.ndindex(2 * _WINDOW_RADIUS + 1, 2 * _WINDOW_RADIUS + 1):
        sample = around[row : row + height, column : column + width]
        color = seen[row : row + height, column : column + width]
        sides = np.stack([sample > middle, (sample > 0) & (sample <= middle)]).astype(np.float32)
        count += sides
        total += sides[..., None] * color
        squares += sides * np.sum(color * color, axis=2)
    mean = total / np.maximum(count, 1)[..., None]
    spread = np.maximum(squares / np.maximum(count, 1) - np.sum(mean * mean, axis=3), 0).sum(axis=0)
    apart = np.sum((mean[0] - mean[1]) ** 2, axis=2) > _MIN_SEPARATION * (
        spread + 3 * _MIN_COLOR_DEVIATION**2
    )
    return np.asarray(apart & (count.min(axis=0) >= 2), np.float32)


def _estimate_at_jumps(
    inverse: Image, guide: _Guide | None, at: tuple[Indices, Indices], factor: int
) -> Image:
    """Compute the inverse depth (n,) of pixels next to depth jumps.

    Each pixel uses samples of one side only.

    Parameters
    ----------
    inverse : (h, w) inverse depth of the samples.
    guide : photo; None without a photo.
    at : rows and columns (n,) of the pixels in the upsampled image.
    factor : upsampling factor.
    """
    rows, columns = at
    row, column = rows // factor, columns // factor
    # Offset from the pixel to the sample that contains it, in samples.
    down = (row - (rows + 0.5) / factor + 0.5).astype(np.float32)
    across = (column - (columns + 0.5) / factor + 0.5).astype(np.float32)
    offsets = [
        (y, x)
        for y in range(-_WINDOW_RADIUS, _WINDOW_RADIUS + 1)
        for x in range(-_WINDOW_RADIUS, _WINDOW_RADIUS + 1)
    ]
    x = np.stack([across + k for _, k in offsets])
    y = np.stack([down + k for k, _ in offsets])
    around = _pad(inverse)
    samples = np.stack([around[row + _WINDOW_RADIUS + j, column + _WINDOW_RADIUS + i] for j, i in offsets])
    distance2 = x * x + y * y
    unlike = np.zeros_like(x)
    if guide is not None:
        colors, own = _pad(guide.samples), guide.pixels[rows, columns]
        for k, (j, i) in enumerate(offsets):
            difference = colors[row + _WINDOW_RADIUS + j, column + _WINDOW_RADIUS + i] - own
            unlike[k] = (difference * difference).sum(axis=1)
        unlike *= guide.is_separable[row, column] / np.float32(2 * 3 * _COLOR_SIGMA**2)
    there = samples > 0
    vote = np.where(there, np.exp(-distance2 / np.float32(2 * _VOTE_SIGMA**2) - unlike), np.float32(0))
    votes = np.zeros_like(vote)
    for k, sample in enumerate(samples):
        votes[k] = (vote * _is_same_surface(samples, sample)).sum(axis=0) * there[k]
    # The small term breaks ties in favour of the nearest sample.
    chosen = np.take_along_axis(samples, (votes + np.float32(1e-3) * vote).argmax(axis=0)[None], axis=0)[0]
    weight = np.exp(-distance2 / np.float32(2 * _FIT_SIGMA**2) - unlike) * (
        _is_same_surface(samples, chosen) & there
    )
    # Keeps the sum of weights above zero even if all samples are distant or differ in colour.
    weight += np.float32(1e-12) * (samples == chosen)
    return _fit_planes(samples, weight, x, y, chosen)


def _fit_planes(samples: Image, weight: Image, x: Image, y: Image, chosen: Image) -> Image:
    """Fit planes to weighted samples, and evaluate them at the pixels.

    Parameters
    ----------
    samples, weight : (n, pixels), inverse depth and weights.
    x, y : (n, pixels), position of the samples relative to the pixel.
    chosen : (pixels,), inverse depth of the chosen side; the result is clamped to its neighbourhood.
    """
    weight = weight / weight.sum(axis=0)

    def average(values: Image) -> Image:
        return np.asarray((weight * values).sum(axis=0))

    x0, y0, value = average(x), average(y), average(samples)
    x, y, samples = x - x0, y - y0, samples - value
    xx, yy, xy = (
        average(x * x) + np.float32(_SLOPE_REGULARISATION),
        average(y * y) + np.float32(_SLOPE_REGULARISATION),
        average(x * y),
    )
    xv, yv = average(x * samples), average(y * samples)
    determinant = xx * yy - xy * xy
    value = value - ((xv * yy - yv * xy) * x0 + (yv * xx - xv * xy) * y0) / determinant
    return np.asarray(
        np.clip(value, chosen * np.float32(1 - _MAX_JUMP_RATIO), chosen * np.float32(1 + _MAX_JUMP_RATIO))
    )


def _is_same_surface(samples: Image, sample: Image) -> NDArray[np.bool_]:
    return np.asarray(np.abs(samples - sample) <= np.float32(_MAX_JUMP_RATIO) * sample)


def _pad(image: Image) -> Image:
    return np.pad(
        image, [(_WINDOW_RADIUS, _WINDOW_RADIUS), (_WINDOW_RADIUS, _WINDOW_RADIUS), (0, 0)][: image.ndim]
    )
