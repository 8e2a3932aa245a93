"""Small depth maps made larger by the photo beside them, as phones leave them.

Between samples of one surface inverse depth is interpolated, which is exact on planes. Beside a jump a pixel
belongs to one side: that of the samples around it that have its colour, if the photo tells both sides apart
there, and else that of those that are near to it (joint bilateral upsampling, Kopf et al. 2007, as a vote).
Its depth is that of a plane through the samples of that side alone: nothing lies between two surfaces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.codes import USAGE_ARGUMENT_INVALID
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.depth_filter import bridge_gaps
from scanloom.stages.frames.matching_color import read_matching_color
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.scans.model.images import read_color, read_depth
from scanloom.stages.scans.model.scan import ColorImage, DepthImage, Frame, pinhole, scaled

Image = NDArray[np.float32]
Indices = NDArray[np.intp]

# Neighbours whose inverse depth differs by more than this share of itself are of two surfaces.
_JUMP = 0.03
# Samples each way that vote.
_REACH = 2
# How far a sample's vote reaches, and its say in the plane, in samples; and colours that are alike, levels.
_VOTE, _FIT, _ALIKE = 1.0, 0.7, 12.0
# The photo tells two sides apart where their mean colours differ by so many times what colours spread within
# them, squared; and what they spread in any photo, levels.
_APART, _SPREAD = 16.0, 6.0
# Slopes are drawn to zero by so much where few samples tell them, samples squared.
_STIFF = 0.15
# Blur of the photo where a sample is, as a share of the samples' distance: what a sample saw of it.
_SEEN = 0.35
# Pixels beside jumps that are worked on at once, for the memory they take.
_AT_ONCE = 100_000


def upsampled_alone(frames: Sequence[Frame], params: FuseParams) -> Sequence[Frame]:
    """Return a frame alone with a larger depth map, if the parameters say so; several as they are.

    Voxels are derived from what it is then; those of several frames, from what was measured.
    """
    if len(frames) != 1 or params.upsample == "off":
        return frames
    least_ratio = params.upsample_factor if params.upsample == "auto" else 0
    try:
        return [upsampled_frame(frames[0], params, least_ratio)]
    except InputError:
        return frames  # Told where the frame is read.


def upsampled_frame(frame: Frame, params: FuseParams, least_ratio: float = 0.0) -> Frame:
    """Return a frame with its depth map, and its photo as the depth map sees it, larger by a factor.

    Parameters
    ----------
    params : `upsample_factor`; gaps of a pixel are bridged by `max_jump` first, as fusion does it, since they
        are wider afterwards.
    least_ratio : a frame whose photo is not so many times as wide as its depth map stays as it is, and so
        does one without a photo; if 0, all are made larger.

    Raises
    ------
    InputError
        If its images cannot be read.
    """
    depth, photo = read_depth(frame), read_color(frame)
    if depth is None or (photo.shape[1] if photo is not None else 0) < least_ratio * depth.shape[1]:
        return frame
    depth, _ = bridge_gaps(depth, params.max_jump)
    factor, (height, width) = params.upsample_factor, depth.shape
    wide = scaled(pinhole(frame.camera), factor * width, factor * height)
    # Depth that is read has neither any more.
    frame = replace(frame, camera=wide, confidence=None, least_confidence=0, mask=None, shutter_turn=None)
    if photo is None:
        return replace(frame, depth=upsampled(depth, None, factor))
    placed = replace(
        frame,
        color=photo,
        color_camera=None if frame.color_camera is None else pinhole(frame.color_camera),
    )
    color = read_matching_color(placed, np.repeat(np.repeat(depth, factor, axis=0), factor, axis=1))
    larger = upsampled(depth, color, factor)
    return replace(placed, color=color, color_camera=None, color_from_depth=None, depth=larger)


def upsampled(depth: DepthImage, color: ColorImage | None, factor: int) -> DepthImage:
    """Return a depth map larger by a whole factor.

    Parameters
    ----------
    depth : (h, w) float32 metres, 0 where missing.
    color : (factor · h, factor · w, 3) uint8 RGB, what the larger map's pixels show; None for none.

    Returns
    -------
    (factor · h, factor · w) float32 metres; 0 where the nearest sample is missing.

    Raises
    ------
    InputError
        If the colour is of another size.
    """
    import cv2

    height, width = (factor * side for side in depth.shape)
    if color is not None and color.shape[:2] != (height, width):
        raise InputError(
            USAGE_ARGUMENT_INVALID,
            "colour is {color_shape} × {color_shape_2}, not {width} × {height}.",
            color_shape=color.shape[1],
            color_shape_2=color.shape[0],
            width=width,
            height=height,
        )
    there = depth > 0
    inverse = _inverse(depth)
    total, share = (
        np.asarray(cv2.resize(image, (width, height), interpolation=cv2.INTER_LINEAR), np.float32)
        for image in (inverse, there.astype(np.float32))
    )
    near = np.arange(height) // factor, np.arange(width) // factor
    is_known = there[near[0]][:, near[1]]
    larger = np.where(is_known, total / np.maximum(share, np.float32(1e-6)), np.float32(0))
    rows, columns = np.nonzero(_torn(inverse)[near[0]][:, near[1]] & is_known)
    guide = None if color is None else _guide(inverse, color, factor)
    for first in range(0, len(rows), _AT_ONCE):
        at = rows[first : first + _AT_ONCE], columns[first : first + _AT_ONCE]
        larger[at] = _of_one_side(inverse, guide, at, factor)
    return _inverse(larger)


@dataclass(frozen=True, eq=False)
class _Guide:
    """The photo for pixels (h·k, w·k, 3) and for samples (h, w, 3), and where it tells sides apart."""

    pixels: Image
    samples: Image
    tells: Image


def _guide(inverse: Image, color: ColorImage, factor: int) -> _Guide:
    import cv2

    colors = color.astype(np.float32)
    blurred = cv2.GaussianBlur(colors, (0, 0), _SEEN * factor)
    size = inverse.shape[1], inverse.shape[0]
    samples = np.asarray(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), np.float32)
    return _Guide(colors, samples, _telling(inverse, samples))


def _inverse(image: Image) -> Image:
    return np.asarray(np.divide(1, image, out=np.zeros_like(image), where=image > 0), np.float32)


def _torn(inverse: Image) -> NDArray[np.bool_]:
    """Return which samples have neighbours of another surface."""
    return np.asarray(_farthest(inverse, 1) < _nearest(inverse, 1) / np.float32(1 + _JUMP))


def _nearest(inverse: Image, reach: int) -> Image:
    import cv2

    return np.asarray(cv2.dilate(inverse, np.ones((2 * reach + 1,) * 2, np.uint8)), np.float32)


def _farthest(inverse: Image, reach: int) -> Image:
    import cv2

    known = np.where(inverse > 0, inverse, np.float32(np.inf))
    return np.asarray(cv2.erode(known, np.ones((2 * reach + 1,) * 2, np.uint8)), np.float32)


def _telling(inverse: Image, colors: Image) -> Image:
    """Return 1 for samples around which near and far differ in colour (Fisher's criterion), else 0."""
    height, width = inverse.shape
    with np.errstate(invalid="ignore"):
        middle = (_nearest(inverse, _REACH) + _farthest(inverse, _REACH)) / 2
    around, seen = _padded(inverse), _padded(colors)
    # Of the near and of the far side: how many, the sum of their colours, and of their squares.
    count, total = np.zeros((2, height, width), np.float32), np.zeros((2, height, width, 3), np.float32)
    squares = np.zeros_like(count)
    for row, column in np.ndindex(2 * _REACH + 1, 2 * _REACH + 1):
        sample = around[row : row + height, column : column + width]
        color = seen[row : row + height, column : column + width]
        sides = np.stack([sample > middle, (sample > 0) & (sample <= middle)]).astype(np.float32)
        count += sides
        total += sides[..., None] * color
        squares += sides * np.sum(color * color, axis=2)
    mean = total / np.maximum(count, 1)[..., None]
    spread = np.maximum(squares / np.maximum(count, 1) - np.sum(mean * mean, axis=3), 0).sum(axis=0)
    apart = np.sum((mean[0] - mean[1]) ** 2, axis=2) > _APART * (spread + 3 * _SPREAD**2)
    return np.asarray(apart & (count.min(axis=0) >= 2), np.float32)


def _of_one_side(inverse: Image, guide: _Guide | None, at: tuple[Indices, Indices], factor: int) -> Image:
    """Return the inverse depth of pixels beside jumps."""
    rows, columns = at
    row, column = rows // factor, columns // factor
    # From the pixel to the sample that it lies in, in samples.
    down = (row - (rows + 0.5) / factor + 0.5).astype(np.float32)
    across = (column - (columns + 0.5) / factor + 0.5).astype(np.float32)
    offsets = [(y, x) for y in range(-_REACH, _REACH + 1) for x in range(-_REACH, _REACH + 1)]
    x = np.stack([across + k for _, k in offsets])
    y = np.stack([down + k for k, _ in offsets])
    around = _padded(inverse)
    samples = np.stack([around[row + _REACH + j, column + _REACH + i] for j, i in offsets])
    distance2 = x * x + y * y
    unlike = np.zeros_like(x)
    if guide is not None:
        colors, own = _padded(guide.samples), guide.pixels[rows, columns]
        for k, (j, i) in enumerate(offsets):
            difference = colors[row + _REACH + j, column + _REACH + i] - own
            unlike[k] = (difference * difference).sum(axis=1)
        unlike *= guide.tells[row, column] / np.float32(2 * 3 * _ALIKE**2)
    there = samples > 0
    vote = np.where(there, np.exp(-distance2 / np.float32(2 * _VOTE**2) - unlike), np.float32(0))
    votes = np.zeros_like(vote)
    for k, sample in enumerate(samples):
        votes[k] = (vote * _same(samples, sample)).sum(axis=0) * there[k]
    # Where all are equal, the first of the nearest.
    chosen = np.take_along_axis(samples, (votes + np.float32(1e-3) * vote).argmax(axis=0)[None], axis=0)[0]
    weight = np.exp(-distance2 / np.float32(2 * _FIT**2) - unlike) * (_same(samples, chosen) & there)
    # None is so far or so unlike that nothing is left of a side.
    weight += np.float32(1e-12) * (samples == chosen)
    return _plane(samples, weight, x, y, chosen)


def _plane(samples: Image, weight: Image, x: Image, y: Image, chosen: Image) -> Image:
    """Return where planes through weighted samples (n, pixels) pass at x = y = 0, near those chosen."""
    weight = weight / weight.sum(axis=0)

    def mean(values: Image) -> Image:
        return np.asarray((weight * values).sum(axis=0))

    x0, y0, value = mean(x), mean(y), mean(samples)
    x, y, samples = x - x0, y - y0, samples - value
    xx, yy, xy = mean(x * x) + np.float32(_STIFF), mean(y * y) + np.float32(_STIFF), mean(x * y)
    xv, yv = mean(x * samples), mean(y * samples)
    determinant = xx * yy - xy * xy
    value = value - ((xv * yy - yv * xy) * x0 + (yv * xx - xv * xy) * y0) / determinant
    return np.asarray(np.clip(value, chosen * np.float32(1 - _JUMP), chosen * np.float32(1 + _JUMP)))


def _same(samples: Image, sample: Image) -> NDArray[np.bool_]:
    return np.asarray(np.abs(samples - sample) <= np.float32(_JUMP) * sample)


def _padded(image: Image) -> Image:
    return np.pad(image, [(_REACH, _REACH), (_REACH, _REACH), (0, 0)][: image.ndim])
