"""Offset between photos and depth maps, measured at silhouettes.

Feature matches barely constrain a constant photo-to-depth offset: depth changes little over a few pixels of a
surface, and poses absorb the rest. Silhouettes show the offset directly. The photo's gradient is sampled
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

from scanloom.stages.adjusting.cameras import get_lens_parameters, transform_points
from scanloom.stages.adjusting.lens import DISTORTION_COEFFICIENT_COUNT, compute_rays, project_with_distortion
from scanloom.stages.adjusting.silhouettes import detect_silhouettes
from scanloom.stages.adjusting.view import read_distorted_color
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Camera, ColorImage, Frame, Pose

# Maximum number of sampled frames, of silhouette points per frame, and maximum photo width in pixels (wider
# photos are downscaled).
_MAX_FRAMES, _MAX_POINTS, _MAX_WIDTH_PX = 24, 4000, 640
# Maximum shift, and maximum change of object width on each side, pixels of the downscaled photos.
_MAX_SHIFT_PX, _MAX_THINNING_PX = 10, 4
_PROFILE_RADIUS_PX = _MAX_SHIFT_PX + _MAX_THINNING_PX + 1
# Maximum additional shift at twice the typical inverse depth, pixels. Then the numbers of bins of silhouette
# points, by direction and by depth.
_MAX_NEAR_SHIFT_PX = 24
_DIRECTION_BINS, _DEPTH_BINS = 64, 6
# Blur of photos before gradients are taken, pixels; gradient caused by image noise, 8-bit levels.
_PHOTO_BLUR_PX, _NOISE_LEVELS = 0.8, 3.0
# Directions with fewer silhouette points than this ratio of the most frequent direction get a lower weight.
_MIN_DIRECTION_RATIO = 0.2
# Blur of gradient profiles along the normal, pixels: in the grid search and in the refinement. Then the step
# sizes of the refinement, pixels.
_GRID_BLUR_PX, _REFINE_BLUR_PX = 1.5, 0.8
_REFINE_STEPS_PX = (1.0, 0.5, 0.25, 0.1, 0.05)
# Criteria of a clear offset. It has at least `_MIN_OFFSET_PX` pixels, and exceeds the change of object width,
# which is not quite equal on all sides (depth from stereo matching seems to have an error of nearly 2 px).
# Both halves of the frames find it within `_MAX_DIFFERENCE_PX` pixels or the ratio `_MAX_DIFFERENCE_RATIO`.
# The offset found by one half raises the gradient of the other half by the factor `_MIN_GRADIENT_GAIN`.
_MIN_OFFSET_PX, _MAX_DIFFERENCE_PX, _MAX_DIFFERENCE_RATIO, _MIN_GRADIENT_GAIN = 2.0, 1.0, 0.25, 1.05
# Quantiles of relative inverse depth that represent far and near silhouettes.
_FAR_NEAR_QUANTILES = (0.1, 0.9)
# Minimum number of silhouette points for a measurement.
_MIN_POINTS = 500


@dataclass(frozen=True, eq=False)
class SilhouetteObservation:
    """Silhouettes of a depth map, with the photo of the same frame.

    Attributes
    ----------
    points, outer_points : (n, 3) silhouette points, and points one pixel further outwards; metres,
        depth-camera axes.
    photo : (h, w, 3) uint8, with lens distortion, blurred, at most 640 wide.
    full_size : (width, height) of the stored photo.
    """

    points: NDArray[np.float64]
    outer_points: NDArray[np.float64]
    photo: ColorImage
    full_size: tuple[int, int]


@dataclass(frozen=True, eq=False)
class PhotoOffset:
    """Offset of photos relative to depth maps.

    Attributes
    ----------
    shift_px : (2,) shift to the right and down at the typical depth, pixels of the stored photos.
    near_shift_px : (2,) additional shift of the nearest tenth of the silhouettes, same unit.
    thinning_px : width that objects lose in depth maps on each side, same unit.
    is_clear : both halves of the frames confirm the offset.
    principal_point_shift_px : (2,) correction of the principal point, same unit.
    translation_m : (2,) correction of `read_color_from_depth`: translation to the right and down, metres.
    """

    shift_px: NDArray[np.float64]
    near_shift_px: NDArray[np.float64]
    thinning_px: float
    is_clear: bool
    principal_point_shift_px: NDArray[np.float64]
    translation_m: NDArray[np.float64]

    @property
    def description(self) -> str:
        """Return the shift as text."""
        right, down = self.shift_px
        across = f"{abs(right):.1f} px to the {'right' if right >= 0 else 'left'}"
        return f"{across} and {abs(down):.1f} px {'down' if down >= 0 else 'up'}"

    def to_dict(self) -> dict[str, Any]:
        """Return the offset as JSON values."""
        (right, down), (near_right, near_down) = self.shift_px.tolist(), self.near_shift_px.tolist()
        return {
            "right_px": right,
            "down_px": down,
            "near_right_px": near_right,
            "near_down_px": near_down,
            "thinning_px": self.thinning_px,
            "is_clear": self.is_clear,
        }


def observe_silhouettes(
    frames: Sequence[Frame], frame_indices: Sequence[int], progress: Progress = ignore_progress
) -> list[SilhouetteObservation]:
    """Detect silhouettes in a sample of the frames.

    Parameters
    ----------
    frames : frames of the scan.
    frame_indices : indices of the frames with colour and depth.
    progress : called with the number of examined frames, and the total.

    Returns
    -------
    Silhouettes of the readable frames; an empty list if photos differ in size.
    """
    chosen = sample_evenly(len(frame_indices), _MAX_FRAMES)
    threads = get_worker_count()
    wanted = [frames[frame_indices[n]] for n in chosen]
    found = []
    observed = map_ordered(_observe_frame, wanted, threads=threads, max_pending=threads + 2)
    for done, one in enumerate(observed, 1):
        if one is not None:
            found.append(one)
        progress(done, len(wanted))
    return found if len({one.full_size for one in found}) == 1 else []


def estimate_photo_offset(
    observations: Sequence[SilhouetteObservation], camera: Camera, color_from_depth: Pose
) -> PhotoOffset | None:
    """Estimate the offset between photos and depth maps.

    Parameters
    ----------
    observations : silhouettes of frames with one common colour camera.
    camera : intrinsics of the colour camera, for any image size.
    color_from_depth : (4, 4) extrinsics of the colour camera, metres.

    Returns
    -------
    Offset, or None with fewer than two frames or too few silhouette points.
    """
    if len(observations) < 2 or sum(len(one.points) for one in observations) < _MIN_POINTS:
        return None
    height, width = observations[0].photo.shape[:2]
    lens = get_lens_parameters(camera, width, height)
    inverse = np.concatenate([1 / one.points[:, 2] for one in observations])
    usual = float(np.median(inverse))
    edges = np.quantile(inverse / usual - 1, np.linspace(0, 1, _DEPTH_BINS + 1)[1:-1])
    profiles = [_compute_profiles(one, lens, color_from_depth, usual, edges) for one in observations]
    halves = [_sum_profiles(profiles[half::2]) for half in (0, 1)]
    if min(half.counts.sum() for half in halves) < _MIN_POINTS / 2:
        return None
    together = _sum_profiles(profiles)
    nearer = np.quantile(inverse / usual - 1, _FAR_NEAR_QUANTILES)
    best, is_clear = _estimate_unknowns(
        _OffsetScore(together), [_OffsetScore(half) for half in halves], float(nearer[1] - nearer[0]) / 2
    )
    scale = observations[0].full_size[0] / width
    return PhotoOffset(
        shift_px=best[:2] * scale,
        near_shift_px=best[2:4] * nearer[1] * scale,
        thinning_px=float(best[4]) * scale,
        is_clear=is_clear,
        principal_point_shift_px=(best[:2] - best[2:4]) * scale,
        translation_m=best[2:4] / (lens[:2] * usual),
    )


def _observe_frame(frame: Frame) -> SilhouetteObservation | None:
    import cv2

    try:
        depth, photo = read_depth(frame), read_distorted_color(frame)
    except InputError:
        return None
    if depth is None or photo is None:
        return None
    full_size = (photo.shape[1], photo.shape[0])
    if photo.shape[1] > _MAX_WIDTH_PX:
        size = (_MAX_WIDTH_PX, max(round(photo.shape[0] * _MAX_WIDTH_PX / photo.shape[1]), 1))
        photo = np.asarray(cv2.resize(photo, size, interpolation=cv2.INTER_AREA), np.uint8)
    found = detect_silhouettes(depth)
    some = np.s_[:: max(-(-len(found.depths) // _MAX_POINTS), 1)]
    camera = frame.camera
    lens = np.array([camera.fx, camera.fy, camera.cx, camera.cy, *[0.0] * DISTORTION_COEFFICIENT_COUNT])
    depths = found.depths[some, None].astype(np.float64)
    ends, outer = (
        compute_rays(found.pixels[some] + step * found.normals[some], lens) * depths for step in (0, 1)
    )
    return SilhouetteObservation(
        ends, outer, np.asarray(cv2.GaussianBlur(photo, (0, 0), _PHOTO_BLUR_PX), np.uint8), full_size
    )


class _GradientProfiles(NamedTuple):
    """Photo gradients along silhouette normals, summed in bins of depth and direction.

    Attributes
    ----------
    gradient_sums : (depths, directions, 2 reach + 1) sums of squared gradients, normalised per silhouette
        point.
    counts : (depths, directions) number of points.
    nearness : (depths,) sums of the inverse depth relative to the typical one, minus 1.
    """

    gradient_sums: NDArray[np.float64]
    counts: NDArray[np.float64]
    nearness: NDArray[np.float64]


def _compute_profiles(
    observation: SilhouetteObservation,
    lens: NDArray[np.float64],
    color_from_depth: Pose,
    typical_inverse_depth: float,
    edges: NDArray[np.float64],
) -> _GradientProfiles:
    import cv2

    apart = np.broadcast_to(color_from_depth, (len(observation.points), 4, 4))
    ends, outer = (
        transform_points(apart, points) for points in (observation.points, observation.outer_points)
    )
    ahead = (ends[:, 2] > 0) & (outer[:, 2] > 0)
    nearness = 1 / (ends[ahead, 2] * typical_inverse_depth) - 1
    pixels = project_with_distortion(ends[ahead], lens)
    normals = project_with_distortion(outer[ahead], lens) - pixels
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-9)[:, None]
    along = np.arange(-_PROFILE_RADIUS_PX - 1, _PROFILE_RADIUS_PX + 2)
    x, y = (pixels[:, axis, None] + along * normals[:, axis, None] for axis in range(2))
    height, width = observation.photo.shape[:2]
    inside = ((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)).all(axis=1)
    found = _GradientProfiles(
        np.zeros((_DEPTH_BINS, _DIRECTION_BINS, 2 * _PROFILE_RADIUS_PX + 1)),
        np.zeros((_DEPTH_BINS, _DIRECTION_BINS)),
        np.zeros(_DEPTH_BINS),
    )
    if not inside.any():
        return found
    x, y, normals, nearness = x[inside], y[inside], normals[inside], nearness[inside]
    levels = cv2.remap(observation.photo, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR)
    levels = levels.astype(np.float64)
    slopes = (((levels[:, 2:] - levels[:, :-2]) / 2) ** 2).sum(axis=2)
    # Normalised per point, so that the position of its largest gradient counts, and not the contrast.
    shares = slopes / (slopes.mean(axis=1, keepdims=True) + _NOISE_LEVELS**2)
    turns = np.arctan2(normals[:, 1], normals[:, 0]) / (2 * np.pi)
    direction = np.floor(turns * _DIRECTION_BINS).astype(np.intp) % _DIRECTION_BINS
    depth = np.searchsorted(edges, nearness)
    np.add.at(found.gradient_sums, (depth, direction), shares)
    np.add.at(found.counts, (depth, direction), 1)
    np.add.at(found.nearness, depth, nearness)
    return found


def _sum_profiles(profiles: Sequence[_GradientProfiles]) -> _GradientProfiles:
    return _GradientProfiles(*(np.sum(part, axis=0) for part in zip(*profiles, strict=True)))


# Indices of the unknowns, in pixels: shift (x, y), additional shift of near points (x, y), and thinning.
_Axes = tuple[int, ...]
_SHIFT: _Axes = (0, 1)
_NEAR_SHIFT: _Axes = (2, 3)
_THINNING: _Axes = (4,)
_LIMITS = np.array(
    [_MAX_SHIFT_PX, _MAX_SHIFT_PX, _MAX_NEAR_SHIFT_PX, _MAX_NEAR_SHIFT_PX, _MAX_THINNING_PX], np.float64
)


class _OffsetScore:
    """Mean photo gradient at the silhouettes as a function of the offset."""

    def __init__(self, profiles: _GradientProfiles) -> None:
        of_direction = profiles.counts.sum(axis=0)
        self._weights = np.minimum(of_direction / max(_MIN_DIRECTION_RATIO * of_direction.max(), 1), 1)
        scales = (self._weights / np.maximum(of_direction, 1))[None, :, None]
        self._means = {
            blur: _blur_profiles(profiles.gradient_sums, blur) * scales
            for blur in (_GRID_BLUR_PX, _REFINE_BLUR_PX)
        }
        self._nearness = profiles.nearness / np.maximum(profiles.counts.sum(axis=1), 1)
        self._grid_maxima: dict[_Axes, NDArray[np.float64]] = {}

    def evaluate(self, candidates: NDArray[np.float64], blur: float) -> NDArray[np.float64]:
        """Compute the mean gradient (n,) for candidate offsets (n, 5)."""
        means, nearness = self._means[blur], self._nearness
        if not candidates[:, _NEAR_SHIFT].any():
            # The offset is equal at all depths: one sixth of the work.
            means, nearness = means.sum(axis=0, keepdims=True), np.zeros(1)
        angles = (np.arange(_DIRECTION_BINS) + 0.5) * (2 * np.pi / _DIRECTION_BINS)
        shifts = candidates[:, None, :2] + nearness[:, None] * candidates[:, None, 2:4]
        off = shifts @ np.stack([np.cos(angles), np.sin(angles)])
        off += candidates[:, None, 4:] + _PROFILE_RADIUS_PX
        off = off.clip(0, 2 * _PROFILE_RADIUS_PX - 1e-9)
        low = off.astype(np.intp)
        share = off - low
        depths, rows = np.arange(len(means))[:, None], np.arange(_DIRECTION_BINS)
        found = (1 - share) * means[depths, rows, low] + share * means[depths, rows, low + 1]
        return np.asarray(found.sum(axis=(1, 2)) / self._weights.sum())

    def find_maximum(self, free: _Axes) -> NDArray[np.float64]:
        """Find the offset (5,) with the largest gradient.

        Parameters
        ----------
        free : indices of the unknowns to estimate; all others are 0.
        """
        # Grid search over the whole range: shift and thinning first, then the depth-dependent shift.
        best = self._search_grid(np.zeros(5), tuple(axis for axis in free if axis not in _NEAR_SHIFT), 1.0)
        best = self._search_grid(best, tuple(axis for axis in free if axis in _NEAR_SHIFT), 3.0)
        axes = np.eye(5)[list(free)]
        for step in _REFINE_STEPS_PX:
            while True:
                around = np.concatenate([best[None], best + step * axes, best - step * axes])
                around = np.clip(around, -_LIMITS, _LIMITS)
                found = np.argmax(self.evaluate(around, _REFINE_BLUR_PX))
                if not found:
                    break
                best = around[found]
        return np.asarray(best)

    def _search_grid(self, start: NDArray[np.float64], axes: _Axes, step: float) -> NDArray[np.float64]:
        """Find the best offset on a grid over some unknowns; the others are as in `start`."""
        # Models with and without a depth-dependent shift begin with the same grid.
        if not axes or (not start.any() and axes in self._grid_maxima):
            return self._grid_maxima[axes] if axes else start
        ranges = [
            np.arange(-_LIMITS[axis], _LIMITS[axis] + 1, step) if axis in axes else start[axis : axis + 1]
            for axis in range(5)
        ]
        grid = np.stack(np.meshgrid(*ranges, indexing="ij"), axis=-1).reshape(-1, 5)
        best = grid[np.argmax(self.evaluate(grid, _GRID_BLUR_PX))]
        if not start.any():
            self._grid_maxima[axes] = best
        return np.asarray(best)


def _blur_profiles(profiles: NDArray[np.float64], sigma: float) -> NDArray[np.float64]:
    """Blur along the last axis with a Gaussian cut off at 4 sigma; ends are mirrored.

    Equal to `scipy.ndimage.gaussian_filter1d`, whose import would delay `inspect`.
    """
    radius, count = int(4 * sigma + 0.5), profiles.shape[-1]
    weights = np.exp(-0.5 / sigma**2 * np.arange(-radius, radius + 1) ** 2)
    weights /= weights.sum()
    padded = np.pad(profiles, [(0, 0)] * (profiles.ndim - 1) + [(radius, radius)], mode="symmetric")
    blurred = padded[..., radius : radius + count] * weights[radius]
    for n in range(radius):
        opposite = 2 * radius - n
        blurred += (padded[..., n : n + count] + padded[..., opposite : opposite + count]) * weights[n]
    return np.asarray(blurred)


def _estimate_unknowns(
    combined: _OffsetScore, halves: Sequence[_OffsetScore], nearness_spread: float
) -> tuple[NDArray[np.float64], bool]:
    """Estimate the offset (5,), and check whether it is clear.

    Parameters
    ----------
    combined : score of all frames.
    halves : score of each half of the frames.
    nearness_spread : half the difference in relative inverse depth between near and far silhouettes.
    """
    of_halves = {
        free: [half.find_maximum(free) for half in halves]
        for free in (_THINNING, _SHIFT + _THINNING, _SHIFT + _NEAR_SHIFT + _THINNING)
    }
    thin, shift, place = of_halves

    def has_gain(free: _Axes, without: _Axes) -> bool:
        return all(
            half.evaluate(one[None], _REFINE_BLUR_PX)
            > _MIN_GRADIENT_GAIN * half.evaluate(other[None], _REFINE_BLUR_PX)
            for half, one, other in zip(halves[::-1], of_halves[free], of_halves[without], strict=True)
        )

    def is_confirmed(free: _Axes, axes: _Axes, scale: float, size: float) -> bool:
        one, other = of_halves[free]
        return float(np.hypot(*(one - other)[list(axes)])) * scale <= max(
            _MAX_DIFFERENCE_PX, _MAX_DIFFERENCE_RATIO * size
        )

    best = combined.find_maximum(place)
    apart = float(np.hypot(*best[2:4])) * nearness_spread
    if (
        apart >= _MIN_OFFSET_PX
        and has_gain(place, shift)
        and is_confirmed(place, _NEAR_SHIFT, nearness_spread, apart)
    ):
        return best, bool((np.abs(best) < _LIMITS)[:4].all())
    best = combined.find_maximum(shift)
    size = float(np.hypot(*best[:2]))
    return best, bool(
        size >= max(_MIN_OFFSET_PX, abs(best[4]))
        and (np.abs(best[:2]) < _MAX_SHIFT_PX).all()
        and has_gain(shift, thin)
        and is_confirmed(shift, _SHIFT, 1.0, size)
    )
