"""How far photos lie beside their depth maps, by the outlines of things in both.

Where poses are fitted to matched points, a photo that lies beside its depth map by the same shift in all
frames is hardly seen: on a surface, depth a few pixels on is nearly the same. At outlines it shows at once.
Beside each point of an outline of the depth map, the photo's gradient is looked at along the normal; of many
points that shift is found by which it is largest (as Levinson and Thrun, "Automatic online calibration of
cameras and lasers", 2013, do it for a laser). Sensors make things wider or thinner on all sides alike; a
shift moves opposite sides the same way, and is told from it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.adjusting.cameras import carried, lens_of
from stages.adjusting.lens import OPENCV, project, rays
from stages.adjusting.outlines import outlines
from stages.adjusting.view import as_taken
from stages.errors import InputError
from stages.scans.images import read_depth
from stages.scans.prefetch import read_ahead, workers
from stages.scans.scan import Camera, ColorImage, Frame, Pose

# Frames that are looked at, and points of each at most; wider photos are made smaller.
_FRAMES, _POINTS, _WIDE = 24, 4000, 640
# How far photos are looked for, and by how much things may be too thin or too wide, pixels of such photos.
_FARTHEST, _THINNER = 10, 4
_REACH = _FARTHEST + _THINNER + 1
_DIRECTIONS = 64
# Blur of photos before gradients are taken, pixels; gradients that are noise, levels.
_BLUR, _NOISE = 0.8, 3.0
# Directions that fewer outlines have than this share of what the most frequent one has count for less.
_RARE = 0.2
# Blurs along the normal, pixels, for a search of the whole range and for one that goes on from there; its
# steps.
_FIRST_BLUR, _THEN_BLUR = 1.5, 0.8
_STEPS = (1.0, 0.5, 0.25, 0.1, 0.05)
# An offset is clear where it is no less than so many pixels, and than what things are thinner or wider by:
# they are not quite so on all sides alike, and depth that is matched in the photos themselves seems to be off
# by nearly two. Either half of the frames finds it to so many pixels or such a share; and by one half's the
# gradient of the other half is so many times what it is without.
_LEAST, _ALIKE, _ALIKE_SHARE, _GAIN = 2.0, 1.0, 0.25, 1.05
# Fewer points of outlines say nothing.
_LEAST_POINTS = 500

Profiles = NDArray[np.float64]
Counts = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class Sight:
    """Outlines of a depth map, and the photo beside it.

    Attributes
    ----------
    ends, outer : (n, 3) metres, axes of the depth camera: points of outlines, and a pixel outwards of them.
    photo : (h, w, 3) uint8 as it was taken, blurred, at most 640 wide.
    full_size : (width, height) of the photo as it is stored.
    """

    ends: NDArray[np.float64]
    outer: NDArray[np.float64]
    photo: ColorImage
    full_size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Offset:
    """Where photos lie.

    Attributes
    ----------
    pixels : (2,) of the photos as they are stored: how far to the right of and below where depth says.
    thinner : how much thinner things are in depth maps than in photos, on each side, pixels of these.
    is_clear : both halves of the frames find it.
    """

    pixels: NDArray[np.float64]
    thinner: float
    is_clear: bool

    @property
    def said(self) -> str:
        """Return words for the shift."""
        right, down = self.pixels
        across = f"{abs(right):.1f} px to the {'right' if right >= 0 else 'left'}"
        return f"{across} and {abs(down):.1f} px {'down' if down >= 0 else 'up'}"

    def figures(self) -> dict[str, Any]:
        """Return it as JSON values."""
        right, down = (float(value) for value in self.pixels)
        return {"right_px": right, "down_px": down, "thinner_px": self.thinner, "is_clear": self.is_clear}


def sights(frames: Sequence[Frame], places: Sequence[int]) -> list[Sight]:
    """Return what some frames at these places (with colour and depth) show; those that cannot be read do not.

    None are returned unless all photos are of one size.
    """
    chosen = np.unique(np.linspace(0, len(places) - 1, min(_FRAMES, len(places))).round().astype(int))
    threads = workers()
    wanted = [frames[places[n]] for n in chosen]
    found = [one for one in read_ahead(_sight, wanted, threads=threads, ahead=threads + 2) if one is not None]
    return found if len({one.full_size for one in found}) == 1 else []


def offset(seen: Sequence[Sight], camera: Camera, color_from_depth: Pose) -> Offset | None:
    """Return where photos lie beside depth; None if less than two frames or too few outlines tell it.

    Parameters
    ----------
    seen : of frames whose photos one camera took.
    camera : that one, for any size of them.
    color_from_depth : (4, 4).
    """
    if len(seen) < 2:
        return None
    height, width = seen[0].photo.shape[:2]
    lens = lens_of(camera, width, height)
    profiles = [_profiles(one, lens, color_from_depth) for one in seen]
    halves = [_summed(profiles[half::2]) for half in (0, 1)]
    together = _summed(profiles)
    if min(count.sum() for _, count in halves) < _LEAST_POINTS / 2:
        return None
    best = _largest(*together)
    scale = seen[0].full_size[0] / width
    return Offset(best[:2] * scale, float(best[2]) * scale, _is_clear(best, halves))


def _sight(frame: Frame) -> Sight | None:
    import cv2

    try:
        depth, photo = read_depth(frame), as_taken(frame)
    except InputError:
        return None
    if depth is None or photo is None:
        return None
    full_size = (photo.shape[1], photo.shape[0])
    if photo.shape[1] > _WIDE:
        size = (_WIDE, max(round(photo.shape[0] * _WIDE / photo.shape[1]), 1))
        photo = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
    found = outlines(depth)
    some = np.s_[:: max(-(-len(found.depths) // _POINTS), 1)]
    camera = frame.camera
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *[0.0] * OPENCV])
    depths = found.depths[some, None].astype(np.float64)
    ends, outer = (rays(found.pixels[some] + step * found.outwards[some], lens) * depths for step in (0, 1))
    return Sight(ends, outer, np.asarray(cv2.GaussianBlur(photo, (0, 0), _BLUR), np.uint8), full_size)


def _profiles(one: Sight, lens: NDArray[np.float64], color_from_depth: Pose) -> tuple[Profiles, Counts]:
    """Return how the photo changes along normals of outlines, summed by direction, and how many those are."""
    import cv2

    apart = np.broadcast_to(color_from_depth, (len(one.ends), 4, 4))
    ends, outer = (carried(apart, points) for points in (one.ends, one.outer))
    ahead = (ends[:, 2] > 0) & (outer[:, 2] > 0)
    pixels = project(ends[ahead], lens)
    normals = project(outer[ahead], lens) - pixels
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]
    along = np.arange(-_REACH - 1, _REACH + 2)
    x, y = (pixels[:, axis, None] + along * normals[:, axis, None] for axis in range(2))
    height, width = one.photo.shape[:2]
    inside = ((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)).all(axis=1)
    directions = np.arctan2(normals[inside, 1], normals[inside, 0]) * (_DIRECTIONS / (2 * np.pi))
    sums = np.zeros((_DIRECTIONS, 2 * _REACH + 1))
    if not inside.any():
        return sums, np.zeros(_DIRECTIONS, np.intp)
    levels = cv2.remap(
        one.photo, x[inside].astype(np.float32), y[inside].astype(np.float32), cv2.INTER_LINEAR
    ).astype(np.float64)
    slopes = (((levels[:, 2:] - levels[:, :-2]) / 2) ** 2).sum(axis=2)
    # All points have the same say: what counts is where along its normal the photo changes most.
    shares = slopes / (slopes.mean(axis=1, keepdims=True) + _NOISE**2)
    which = np.floor(directions).astype(np.intp) % _DIRECTIONS
    np.add.at(sums, which, shares)
    return sums, np.bincount(which, minlength=_DIRECTIONS)


def _summed(profiles: Sequence[tuple[Profiles, Counts]]) -> tuple[Profiles, Counts]:
    sums, counts = zip(*profiles, strict=True)
    return np.sum(sums, axis=0), np.sum(counts, axis=0)


def _gradient(sums: Profiles, counts: Counts, at: NDArray[np.float64], blur: float) -> NDArray[np.float64]:
    """Return the mean gradient for (n, 3) shifts (x, y) and how much thinner things are, pixels."""
    from scipy.ndimage import gaussian_filter1d

    weights = np.minimum(counts / max(_RARE * counts.max(), 1), 1)
    means = gaussian_filter1d(sums, blur, axis=1) * (weights / np.maximum(counts, 1))[:, None]
    angles = (np.arange(_DIRECTIONS) + 0.5) * (2 * np.pi / _DIRECTIONS)
    off = at[:, :2] @ np.stack([np.cos(angles), np.sin(angles)]) + at[:, 2:] + _REACH
    off = off.clip(0, 2 * _REACH - 1e-9)
    low, rows = off.astype(np.intp), np.arange(_DIRECTIONS)
    share = off - low
    return np.asarray(
        ((1 - share) * means[rows, low] + share * means[rows, low + 1]).sum(axis=1) / weights.sum()
    )


def _largest(sums: Profiles, counts: Counts, *, shifts: bool = True) -> NDArray[np.float64]:
    """Return the shift (x, y) and how much thinner things are where the gradient is largest."""
    one = np.arange(-_FARTHEST, _FARTHEST + 1.0) if shifts else np.zeros(1)
    grid = np.stack(np.meshgrid(one, one, np.arange(-_THINNER, _THINNER + 1.0), indexing="ij"), axis=-1)
    grid = grid.reshape(-1, 3)
    best = grid[np.argmax(_gradient(sums, counts, grid, _FIRST_BLUR))]
    limits = np.array([_FARTHEST, _FARTHEST, _THINNER])
    axes = np.eye(3)[0 if shifts else 2 :]
    for step in _STEPS:
        while True:
            around = np.clip(
                np.concatenate([best[None], best + step * axes, best - step * axes]), -limits, limits
            )
            found = np.argmax(_gradient(sums, counts, around, _THEN_BLUR))
            if not found:
                break
            best = around[found]
    return np.asarray(best)


def _is_clear(best: NDArray[np.float64], halves: Sequence[tuple[Profiles, Counts]]) -> bool:
    found = [_largest(*half) for half in halves]
    without = [_largest(*half, shifts=False) for half in halves]
    gains = all(
        _gradient(*other, one[None], _THEN_BLUR) > _GAIN * _gradient(*other, none[None], _THEN_BLUR)
        for one, none, other in zip(found, without, halves[::-1], strict=True)
    )
    size, apart = np.hypot(*best[:2]), np.hypot(*(found[0] - found[1])[:2])
    return bool(
        size >= max(_LEAST, abs(best[2]))
        and np.abs(best[:2]).max() < _FARTHEST
        and apart <= max(_ALIKE, _ALIKE_SHARE * size)
        and gains
    )
