"""Exposure model of photos: gain, bias and vignette.

The level of photo i is modelled as (gain_i · a + bias_i) · v(r), where a is the level common to all photos.
The vignette is v(r) = v₀ (1 + v₁ r² + v₂ r⁴), with r the distance from the photo's centre and mean 1 over a
photo (Goldman 2010, "Vignette and exposure calibration and compensation", equation 1 without the response
curve). White balance is included, because channels are independent.
"""

from __future__ import annotations

import functools
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_ITERATIONS = 6
# Sampled surface points for the fit of all photos, and for the preceding decision about the vignette.
_MAX_POINTS, _VIGNETTE_TEST_POINTS = 40_000, 10_000
# Huber threshold, in levels; and range of levels that are not clipped.
_HUBER_LEVELS = 8.0
_USABLE_LEVELS = (4.0, 250.0)
# Prior that pulls a photo to gain 1 and bias 0: equivalent number of samples, and their spread in levels.
_PRIOR_SAMPLES, _PRIOR_LEVELS = 30.0, 40.0
_MAX_GAIN = 4.0
# Minimum relative change of light in the corners. A weaker vignette averages out, and uncorrected photos look
# natural.
_MIN_VIGNETTE = 0.1
# Plausible range of light in the corners relative to the centre. Values outside come from an object in the
# centre of all photos, not from a lens, and say nothing about the corners.
_MIN_CORNER_LIGHT, _MAX_CORNER_LIGHT = 0.2, 1.5
_NO_VIGNETTE = (1.0, 0.0, 0.0)
# Minimum samples shared with other photos; photos with fewer keep gain 1 and bias 0.
_MIN_SAMPLES = 50
# Rows of a photo corrected per batch: the working set stays in the cache.
_BATCH_ROWS = 32


@dataclass(frozen=True, eq=False)
class Exposure:
    """Exposure of one photo: mapping from scene levels to its levels.

    Attributes
    ----------
    gain, bias : (3,) for red, green and blue; bias in levels.
    vignette : v₀, v₁ and v₂, with r = 1 in the corners.
    """

    gain: Floats
    bias: Floats
    vignette: tuple[float, float, float] = _NO_VIGNETTE

    def correct(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Correct an image (h, w, 3) to gain 1 and bias 0, without vignette."""
        import cv2

        if self.is_identity:
            return image
        height, width = image.shape[:2]
        if self.vignette == _NO_VIGNETTE:
            # Without a vignette the mapping is the same for all pixels: use a lookup table.
            levels = (np.arange(256)[None, :, None] - self.bias) / self.gain
            return np.asarray(cv2.LUT(image, np.rint(levels).clip(0, 255).astype(np.uint8)), np.uint8)
        # Interleaved channels, a few rows at a time: the working set stays in the cache.
        gain, bias = (np.tile(one, width) for one in (self.gain, self.bias))
        corrected = np.empty_like(image)
        for start in range(0, height, _BATCH_ROWS):
            rows = slice(start, start + _BATCH_ROWS)
            light = _evaluate_vignette(_compute_squared_radii(width, height, rows), self.vignette).repeat(
                3, axis=1
            )
            levels = image[rows].reshape(light.shape) / light
            levels -= bias
            levels /= gain
            np.rint(levels, out=levels)
            corrected[rows] = levels.clip(0, 255, out=levels).reshape(corrected[rows].shape)
        return corrected

    @property
    def is_identity(self) -> bool:
        """True if the exposure changes nothing."""
        return bool((self.gain == 1).all() and (self.bias == 0).all() and self.vignette == _NO_VIGNETTE)


def make_identity_exposure() -> Exposure:
    """Return the identity: gain 1, bias 0, no vignette."""
    return Exposure(np.ones(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Exposures:
    """Exposures of all photos, and the differences before and after the fit.

    Attributes
    ----------
    photos : exposure of each photo; the mean log gain is 0.
    difference_before, difference_after : median difference of a sample from the mean of its point, in levels,
        without and with
        exposure correction.
    differences : (n,) the median difference of each photo, after correction.
    samples : (n,) number of points of each photo that another photo also shows.
    """

    photos: tuple[Exposure, ...]
    difference_before: float
    difference_after: float
    differences: Floats
    samples: NDArray[np.int64]

    def reset_corrections(self) -> Exposures:
        """Return a copy without exposure correction."""
        return replace(
            self,
            photos=tuple(make_identity_exposure() for _ in self.photos),
            difference_after=self.difference_before,
        )

    def drop_photos(self, rejected: Container[int]) -> Exposures:
        """Return a copy without the photos of the given indices."""
        rest = [i for i in range(len(self.photos)) if i not in rejected]
        return replace(
            self,
            photos=tuple(self.photos[i] for i in rest),
            differences=self.differences[rest],
            samples=self.samples[rest],
        )


def estimate_exposures(
    views: NDArray[np.int32], colors: NDArray[np.uint8], radii2: NDArray[np.float32], count: int
) -> Exposures:
    """Estimate the exposures of photos from surface points seen by several of them.

    Parameters
    ----------
    views : (n, k) int32, photo of each sample of a point; -1 for none.
    colors : (n, k, 3) uint8, levels of each sample.
    radii2 : (n, k) float32, squared distance from the photo's centre; 1 in the corners.
    count : number of photos.
    """
    step = max(len(views) // _VIGNETTE_TEST_POINTS, 1)
    trial = _fit_exposures(views[::step], colors[::step], radii2[::step], count, vignetted=True)
    center_light, corner_light = _evaluate_vignette(np.array([0.0, 1.0]), trial.photos[0].vignette)
    is_of_lens = _MIN_CORNER_LIGHT * center_light <= corner_light <= _MAX_CORNER_LIGHT * center_light
    is_vignetted = bool(is_of_lens and abs(1 - corner_light) >= _MIN_VIGNETTE)
    return _fit_exposures(views, colors, radii2, count, vignetted=is_vignetted)


def _fit_exposures(
    views: NDArray[np.int32],
    colors: NDArray[np.uint8],
    radii2: NDArray[np.float32],
    count: int,
    *,
    vignetted: bool,
) -> Exposures:
    step = max(len(views) // _MAX_POINTS, 1)
    views, colors, radii2 = views[::step], colors[::step], radii2[::step]
    usable = (
        (views >= 0) & (colors.min(axis=2) >= _USABLE_LEVELS[0]) & (colors.max(axis=2) <= _USABLE_LEVELS[1])
    )
    usable &= usable.sum(axis=1, keepdims=True) > 1
    point, slot = np.nonzero(usable)
    if not len(point):
        none = tuple(make_identity_exposure() for _ in range(count))
        return Exposures(none, 0.0, 0.0, np.zeros(count), np.zeros(count, np.int64))
    view = views[point, slot].astype(np.int64)
    radius2 = radii2[point, slot].astype(np.float64)
    # One array per channel: NumPy is slow over rows of three.
    levels = [colors[point, slot, k].astype(np.float64) for k in range(3)]
    # Renumber the points that are left; `np.nonzero` returns them in order.
    point = np.cumsum(np.diff(point, prepend=point[0]) > 0)
    samples = np.bincount(view, minlength=count)
    is_known = samples >= _MIN_SAMPLES
    # First axis: channels.
    gain, bias = np.ones((3, count)), np.zeros((3, count))
    vignette = _NO_VIGNETTE
    weights = [np.ones_like(radius2)] * 3
    before = 0.0
    for iteration in range(_ITERATIONS + 1):
        light = _evaluate_vignette(radius2, vignette)
        unvignetted = [level / light for level in levels]
        gains, biases = ([np.take(one, view) for one in of] for of in (gain, bias))
        means = [
            _average_samples(point, unvignetted[k], weights[k], gains[k], biases[k])[point] for k in range(3)
        ]
        predicted = [gains[k] * means[k] + biases[k] for k in range(3)]
        differences = [np.abs(levels[k] - predicted[k] * light) for k in range(3)]
        if iteration == 0:
            before = float(np.median(differences))
        if iteration == _ITERATIONS:
            break
        weights = [np.minimum(1.0, _HUBER_LEVELS / np.maximum(one, 1e-9)) for one in differences]
        if vignetted:
            vignette = _fit_vignette(predicted, levels, weights, radius2)
            light = _evaluate_vignette(radius2, vignette)
            unvignetted = [level / light for level in levels]
        for k in range(3):
            gain[k], bias[k] = _fit_gain_and_bias(view, means[k], unvignetted[k], weights[k], count)
        gain[:, ~is_known], bias[:, ~is_known] = 1.0, 0.0
        if is_known.any():
            # Only ratios of gains are observable, so the mean log gain is fixed at 0. The common offset is
            # removed in scene levels; each photo's bias therefore changes in proportion to its gain.
            gain[:, is_known] /= np.exp(np.log(gain[:, is_known]).mean(axis=1, keepdims=True))
            middle = bias[:, is_known].mean(axis=1, keepdims=True) / gain[:, is_known].mean(
                axis=1, keepdims=True
            )
            bias[:, is_known] -= gain[:, is_known] * middle
    largest = functools.reduce(np.maximum, differences)
    by_view = np.argsort(view, kind="stable")
    differences_by_photo = np.split(largest[by_view], np.cumsum(samples)[:-1])
    return Exposures(
        photos=tuple(Exposure(gain[:, i].copy(), bias[:, i].copy(), vignette) for i in range(count)),
        difference_before=before,
        difference_after=float(np.median(differences)),
        differences=np.array([float(np.median(one)) if len(one) else 0.0 for one in differences_by_photo]),
        samples=samples,
    )


def _fit_vignette(
    shown: Sequence[Floats], levels: Sequence[Floats], weights: Sequence[Floats], radius2: Floats
) -> tuple[float, float, float]:
    """Fit the vignette by least squares.

    The model is level = shown · (1 + v₁ r² + v₂ r⁴). A prior pulls v₁ and v₂ to 0. v₀ normalises the mean
    over a photo to 1.
    """
    normal = _PRIOR_SAMPLES * _PRIOR_LEVELS**2 * np.eye(2)
    right = np.zeros(2)
    for bright, level, weight in zip(shown, levels, weights, strict=True):
        rows = [bright * radius2, bright * radius2**2]
        weighted = [weight * row for row in rows]
        normal += [[float((a * b).sum()) for a in rows] for b in weighted]
        right += [float((a * (level - bright)).sum()) for a in weighted]
    found = np.linalg.solve(normal, right)
    # The means over a photo are 1/3 for r², and about 1/6 for r⁴.
    return (1 / float(1 + found[0] / 3 + found[1] / 6), float(found[0]), float(found[1]))


def _average_samples(
    point: NDArray[np.int64], levels: Floats, weight: Floats, gain: Floats, bias: Floats
) -> Floats:
    """Return the weighted mean of the corrected samples of each point."""
    weight = weight * gain**2
    total = np.bincount(point, weight)
    return np.asarray(np.bincount(point, weight * ((levels - bias) / gain)) / np.maximum(total, 1e-12))


def _fit_gain_and_bias(
    view: NDArray[np.int64], mean: Floats, level: Floats, weight: Floats, count: int
) -> tuple[Floats, Floats]:
    """Fit gain and bias of each photo by least squares.

    The model is level = gain · mean + bias, with a prior at gain 1 and bias 0.
    """

    def sum_by_photo(values: Floats) -> Floats:
        return np.asarray(np.bincount(view, values, minlength=count), np.float64)

    n, sa, sy = sum_by_photo(weight), sum_by_photo(weight * mean), sum_by_photo(weight * level)
    middle = np.divide(sa, n, out=np.full(count, 128.0), where=n > 0)
    centered = mean - middle[view]
    saa = sum_by_photo(weight * centered**2) + _PRIOR_SAMPLES * _PRIOR_LEVELS**2
    say = sum_by_photo(weight * centered * level) + _PRIOR_SAMPLES * _PRIOR_LEVELS**2
    gain = (say / saa).clip(1 / _MAX_GAIN, _MAX_GAIN)
    return gain, (sy - gain * sa) / (n + _PRIOR_SAMPLES)


def _compute_squared_radii(width: int, height: int, rows: slice) -> Floats:
    x, y = (np.linspace(-1, 1, size) for size in (width, height))
    aspect = height / width
    return np.asarray((x[None, :] ** 2 + (aspect * y[rows, None]) ** 2) / (1 + aspect**2))


def _evaluate_vignette(radii2: Floats, vignette: tuple[float, float, float]) -> Floats:
    """Evaluate the vignette at squared distances from the centre; 1 in the corners."""
    return np.asarray(vignette[0] * (1 + vignette[1] * radii2 + vignette[2] * radii2**2))
