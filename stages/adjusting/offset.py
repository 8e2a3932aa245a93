"""Offset between photos and depth maps, measured at silhouettes.

Feature matches barely constrain a constant photo-to-depth offset: depth changes little over a few pixels of
a surface, and poses absorb the rest. Silhouettes show the offset directly. The photo's gradient is sampled
along the normal of each silhouette point of the depth map. The offset is the shift with the largest mean
gradient. Levinson and Thrun ("Automatic online calibration of cameras and lasers", 2013) do this for a lidar.
Sensors also make objects wider or thinner on all sides. A shift moves opposite sides in the same direction,
which separates the two effects. If near and far silhouettes shift differently, the position of the colour
camera is wrong; its error is estimated together with the shift.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.adjusting.cameras import carried, lens_of
from scanloom.stages.adjusting.lens import OPENCV, project, rays
from scanloom.stages.adjusting.outlines import outlines
from scanloom.stages.adjusting.view import as_taken
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose

# Maximum number of sampled frames, of silhouette points per frame, and maximum photo width in pixels (wider
# photos are downscaled).
_FRAMES, _POINTS, _WIDE = 24, 4000, 640
# Maximum shift, and maximum change of object width on each side, pixels of the downscaled photos.
_FARTHEST, _THINNER = 10, 4
_REACH = _FARTHEST + _THINNER + 1
# Maximum additional shift at twice the typical inverse depth, pixels. Then the numbers of bins of silhouette
# points, by direction and by depth.
_FARTHEST_NEAR = 24
_DIRECTIONS, _DEPTHS = 64, 6
# Blur of photos before gradients are taken, pixels; gradient caused by image noise, 8-bit levels.
_BLUR, _NOISE = 0.8, 3.0
# Directions with fewer silhouette points than this ratio of the most frequent direction get a lower weight.
_RARE = 0.2
# Blur of gradient profiles along the normal, pixels: in the grid search and in the refinement. Then the step
# sizes of the refinement, pixels.
_FIRST_BLUR, _THEN_BLUR = 1.5, 0.8
_STEPS = (1.0, 0.5, 0.25, 0.1, 0.05)
# Criteria of a clear offset. It has at least `_LEAST` pixels, and exceeds the change of object width, which
# is not quite equal on all sides (depth from stereo matching seems to be off by nearly 2 px). Both halves of
# the frames find it within `_ALIKE` pixels or the ratio `_ALIKE_SHARE`. The offset found by one half raises
# the gradient of the other half by the factor `_GAIN`.
_LEAST, _ALIKE, _ALIKE_SHARE, _GAIN = 2.0, 1.0, 0.25, 1.05
# Quantiles of relative inverse depth that represent far and near silhouettes.
_NEAR_FAR = (0.1, 0.9)
# Minimum number of silhouette points for a measurement.
_LEAST_POINTS = 500


@dataclass(frozen=True, eq=False)
class Sight:
    """Silhouettes of a depth map, with the photo of the same frame.

    Attributes
    ----------
    ends, outer : (n, 3) silhouette points, and points one pixel further outwards; metres, depth-camera axes.
    photo : (h, w, 3) uint8, with lens distortion, blurred, at most 640 wide.
    full_size : (width, height) of the stored photo.
    """

    ends: NDArray[np.float64]
    outer: NDArray[np.float64]
    photo: ColorImage
    full_size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class Offset:
    """Offset of photos relative to depth maps.

    Attributes
    ----------
    pixels : (2,) shift to the right and down at the typical depth, pixels of the stored photos.
    near : (2,) additional shift of the nearest tenth of the silhouettes, same unit.
    thinner : width that objects lose in depth maps on each side, same unit.
    is_clear : both halves of the frames confirm the offset.
    centre : (2,) correction of the principal point, same unit.
    place : (2,) correction of `color_from_depth`: translation to the right and down, metres.
    """

    pixels: NDArray[np.float64]
    near: NDArray[np.float64]
    thinner: float
    is_clear: bool
    centre: NDArray[np.float64]
    place: NDArray[np.float64]

    @property
    def said(self) -> str:
        """Return the shift as text."""
        right, down = self.pixels
        across = f"{abs(right):.1f} px to the {'right' if right >= 0 else 'left'}"
        return f"{across} and {abs(down):.1f} px {'down' if down >= 0 else 'up'}"

    def figures(self) -> dict[str, Any]:
        """Return the offset as JSON values."""
        (right, down), (near_right, near_down) = self.pixels.tolist(), self.near.tolist()
        return {
            "right_px": right,
            "down_px": down,
            "near_right_px": near_right,
            "near_down_px": near_down,
            "thinner_px": self.thinner,
            "is_clear": self.is_clear,
        }


def sights(frames: Sequence[Frame], places: Sequence[int]) -> list[Sight]:
    """Detect silhouettes in a sample of the frames.

    Parameters
    ----------
    frames : frames of the scan.
    places : indices of the frames with colour and depth.

    Returns
    -------
    Silhouettes of the readable frames; an empty list if photos differ in size.
    """
    chosen = sample_evenly(len(places), _FRAMES)
    threads = workers()
    wanted = [frames[places[n]] for n in chosen]
    found = [one for one in read_ahead(_sight, wanted, threads=threads, ahead=threads + 2) if one is not None]
    return found if len({one.full_size for one in found}) == 1 else []


def offset(seen: Sequence[Sight], camera: Camera, color_from_depth: Pose) -> Offset | None:
    """Estimate the offset between photos and depth maps.

    Parameters
    ----------
    seen : silhouettes of frames with one common colour camera.
    camera : intrinsics of the colour camera, for any image size.
    color_from_depth : (4, 4) extrinsics of the colour camera, metres.

    Returns
    -------
    Offset, or None with fewer than two frames or too few silhouette points.
    """
    if len(seen) < 2 or sum(len(one.ends) for one in seen) < _LEAST_POINTS:
        return None
    height, width = seen[0].photo.shape[:2]
    lens = lens_of(camera, width, height)
    inverse = np.concatenate([1 / one.ends[:, 2] for one in seen])
    usual = float(np.median(inverse))
    edges = np.quantile(inverse / usual - 1, np.linspace(0, 1, _DEPTHS + 1)[1:-1])
    profiles = [_profiles(one, lens, color_from_depth, usual, edges) for one in seen]
    halves = [_summed(profiles[half::2]) for half in (0, 1)]
    if min(half.counts.sum() for half in halves) < _LEAST_POINTS / 2:
        return None
    together = _summed(profiles)
    nearer = np.quantile(inverse / usual - 1, _NEAR_FAR)
    best, is_clear = _found(together, halves, float(nearer[1] - nearer[0]) / 2)
    scale = seen[0].full_size[0] / width
    return Offset(
        pixels=best[:2] * scale,
        near=best[2:4] * nearer[1] * scale,
        thinner=float(best[4]) * scale,
        is_clear=is_clear,
        centre=(best[:2] - best[2:4]) * scale,
        place=best[2:4] / (lens[:2] * usual),
    )


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


class _Profiles(NamedTuple):
    """Photo gradients along silhouette normals, summed in bins of depth and direction.

    Attributes
    ----------
    sums : (depths, directions, 2 reach + 1) sums of squared gradients, normalised per silhouette point.
    counts : (depths, directions) number of points.
    nearness : (depths,) sums of the inverse depth relative to the typical one, minus 1.
    """

    sums: NDArray[np.float64]
    counts: NDArray[np.float64]
    nearness: NDArray[np.float64]


def _profiles(
    one: Sight,
    lens: NDArray[np.float64],
    color_from_depth: Pose,
    usual: float,
    edges: NDArray[np.float64],
) -> _Profiles:
    import cv2

    apart = np.broadcast_to(color_from_depth, (len(one.ends), 4, 4))
    ends, outer = (carried(apart, points) for points in (one.ends, one.outer))
    ahead = (ends[:, 2] > 0) & (outer[:, 2] > 0)
    nearness = 1 / (ends[ahead, 2] * usual) - 1
    pixels = project(ends[ahead], lens)
    normals = project(outer[ahead], lens) - pixels
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]
    along = np.arange(-_REACH - 1, _REACH + 2)
    x, y = (pixels[:, axis, None] + along * normals[:, axis, None] for axis in range(2))
    height, width = one.photo.shape[:2]
    inside = ((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)).all(axis=1)
    found = _Profiles(
        np.zeros((_DEPTHS, _DIRECTIONS, 2 * _REACH + 1)),
        np.zeros((_DEPTHS, _DIRECTIONS)),
        np.zeros(_DEPTHS),
    )
    if not inside.any():
        return found
    x, y, normals, nearness = x[inside], y[inside], normals[inside], nearness[inside]
    levels = cv2.remap(one.photo, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    levels = levels.astype(np.float64)
    slopes = (((levels[:, 2:] - levels[:, :-2]) / 2) ** 2).sum(axis=2)
    # Normalised per point, so that the position of its largest gradient counts, and not the contrast.
    shares = slopes / (slopes.mean(axis=1, keepdims=True) + _NOISE**2)
    turns = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi)
    direction = np.floor(turns * _DIRECTIONS).astype(np.intp) % _DIRECTIONS
    depth = np.searchsorted(edges, nearness)
    np.add.at(found.sums, (depth, direction), shares)
    np.add.at(found.counts, (depth, direction), 1)
    np.add.at(found.nearness, depth, nearness)
    return found


def _summed(profiles: Sequence[_Profiles]) -> _Profiles:
    return _Profiles(*(np.sum(part, axis=0) for part in zip(*profiles, strict=True)))


# Indices of the unknowns, in pixels: shift (x, y), additional shift of near points (x, y), and thinning.
_Axes = tuple[int, ...]
_SHIFT: _Axes = (0, 1)
_PLACE: _Axes = (2, 3)
_THIN: _Axes = (4,)
_LIMITS = np.array([_FARTHEST, _FARTHEST, _FARTHEST_NEAR, _FARTHEST_NEAR, _THINNER], np.float64)


def _gradient(profiles: _Profiles, at: NDArray[np.float64], blur: float) -> NDArray[np.float64]:
    """Compute the mean gradient (n,) for candidate offsets (n, 5)."""
    from scipy.ndimage import gaussian_filter1d

    of_direction = profiles.counts.sum(axis=0)
    weights = np.minimum(of_direction / max(_RARE * of_direction.max(), 1), 1)
    means = gaussian_filter1d(profiles.sums, blur, axis=2)
    means *= (weights / np.maximum(of_direction, 1))[None, :, None]
    nearness = profiles.nearness / np.maximum(profiles.counts.sum(axis=1), 1)
    angles = (np.arange(_DIRECTIONS) + 0.5) * (2 * np.pi / _DIRECTIONS)
    shifts = at[:, None, :2] + nearness[:, None] * at[:, None, 2:4]
    off = shifts @ np.stack([np.cos(angles), np.sin(angles)]) + at[:, None, 4:] + _REACH
    off = off.clip(0, 2 * _REACH - 1e-9)
    low = off.astype(np.intp)
    share = off - low
    depths, rows = np.arange(_DEPTHS)[:, None], np.arange(_DIRECTIONS)
    found = (1 - share) * means[depths, rows, low] + share * means[depths, rows, low + 1]
    return np.asarray(found.sum(axis=(1, 2)) / weights.sum())


def _largest(profiles: _Profiles, free: Sequence[int]) -> NDArray[np.float64]:
    """Find the offset (5,) with the largest gradient.

    Parameters
    ----------
    free : indices of the unknowns to estimate; all others are 0.
    """
    best = np.zeros(5)
    # Grid search over the whole range: shift and thinning first, then the depth-dependent shift.
    for some, step in ((set(_SHIFT + _THIN) & set(free), 1.0), (set(_PLACE) & set(free), 3.0)):
        ranges = [
            np.arange(-_LIMITS[axis], _LIMITS[axis] + 1, step) if axis in some else best[axis : axis + 1]
            for axis in range(5)
        ]
        grid = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 5)
        best = grid[np.argmax(_gradient(profiles, grid, _FIRST_BLUR))]
    axes = np.eye(5)[list(free)]
    for step in _STEPS:
        while True:
            around = np.concatenate([best[None], best + step * axes, best - step * axes])
            around = np.clip(around, -_LIMITS, _LIMITS)
            found = np.argmax(_gradient(profiles, around, _THEN_BLUR))
            if not found:
                break
            best = around[found]
    return np.asarray(best)


def _found(
    together: _Profiles, halves: Sequence[_Profiles], spread: float
) -> tuple[NDArray[np.float64], bool]:
    """Estimate the offset (5,), and check whether it is clear.

    Parameters
    ----------
    together : profiles of all frames.
    halves : profiles of each half of the frames.
    spread : half the difference in relative inverse depth between near and far silhouettes.
    """
    of_halves = {
        free: [_largest(half, free) for half in halves]
        for free in (_THIN, _SHIFT + _THIN, _SHIFT + _PLACE + _THIN)
    }
    thin, shift, place = of_halves

    def told(free: _Axes, without: _Axes) -> bool:
        return all(
            _gradient(half, one[None], _THEN_BLUR) > _GAIN * _gradient(half, other[None], _THEN_BLUR)
            for half, one, other in zip(halves[::-1], of_halves[free], of_halves[without], strict=True)
        )

    def alike(free: _Axes, axes: _Axes, scale: float, size: float) -> bool:
        one, other = of_halves[free]
        return float(np.hypot(*(one - other)[list(axes)])) * scale <= max(_ALIKE, _ALIKE_SHARE * size)

    best = _largest(together, place)
    apart = float(np.hypot(*best[2:4])) * spread
    if apart >= _LEAST and told(place, shift) and alike(place, _PLACE, spread, apart):
        return best, bool((np.abs(best) < _LIMITS)[:4].all())
    best = _largest(together, shift)
    size = float(np.hypot(*best[:2]))
    return best, bool(
        size >= max(_LEAST, abs(best[4]))
        and (np.abs(best[:2]) < _FARTHEST).all()
        and told(shift, thin)
        and alike(shift, _SHIFT, 1.0, size)
    )
