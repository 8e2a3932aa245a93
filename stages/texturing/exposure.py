"""How bright each photo is: a gain and a bias for each channel, and one vignette for all.

A level of photo i is taken for (gain_i · a + bias_i) · v(r), with a what all photos have in common and
v(r) = v₀ (1 + v₁ r² + v₂ r⁴) of the distance from the photo's middle, 1 in the mean over a photo (Goldman
2010, "Vignette and exposure calibration and compensation", equation 1 without the response curve). White
balance is part of it, since channels are apart.
"""

from __future__ import annotations

from collections.abc import Container
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_ROUNDS = 6
# Points are enough for all photos of a scan.
_MOST_POINTS = 40_000
# Levels beyond which a difference counts less and less (Huber), and levels that are cut off.
_HUBER = 8.0
_USABLE = (4.0, 250.0)
# What holds a photo to gain 1 and bias 0: as so many samples would, of this spread in levels.
_PRIOR_SAMPLES, _PRIOR_LEVELS = 30.0, 40.0
_MOST_GAIN = 4.0
# Of the light in the corners: a weaker vignette averages out, and photos look as people know them.
_LEAST_VIGNETTE = 0.1
_NO_VIGNETTE = (1.0, 0.0, 0.0)
# Fewer samples in other photos than this tell nothing.
_LEAST_SAMPLES = 50


@dataclass(frozen=True, eq=False)
class Exposure:
    """What a photo's levels are of those of the scene.

    Attributes
    ----------
    gain, bias : (3,) of red, green and blue; bias in levels.
    vignette : v₀, v₁ and v₂, for r = 1 in the corners.
    """

    gain: Floats
    bias: Floats
    vignette: tuple[float, float, float] = _NO_VIGNETTE

    def corrected(self, image: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Return the image (h, w, 3) as it would be at gain 1, bias 0 and without vignette."""
        import cv2

        if self.is_none:
            return image
        height, width = image.shape[:2]
        if self.vignette == _NO_VIGNETTE:
            # The same for every pixel: looked up.
            levels = (np.arange(256)[None, :, None] - self.bias) / self.gain
            return np.asarray(cv2.LUT(image, np.rint(levels).clip(0, 255).astype(np.uint8)), np.uint8)
        light = _light_at(_radii2(width, height), self.vignette)[..., None]
        levels = (image / light - self.bias) / self.gain
        return np.asarray(np.rint(levels).clip(0, 255), np.uint8)

    @property
    def is_none(self) -> bool:
        """Return whether nothing is to be corrected."""
        return bool((self.gain == 1).all() and (self.bias == 0).all() and self.vignette == _NO_VIGNETTE)


def no_exposure() -> Exposure:
    """Return that of a photo nothing is known of."""
    return Exposure(np.ones(3), np.zeros(3))


@dataclass(frozen=True, eq=False)
class Exposures:
    """How bright photos are.

    Attributes
    ----------
    photos : each one's exposure, of mean log gain 0.
    before, after : median difference of a sample from its point's mean, in levels, without and with them.
    differences : (n,) the same of each photo with them.
    samples : (n,) points of each photo that another one shows, too.
    """

    photos: tuple[Exposure, ...]
    before: float
    after: float
    differences: Floats
    samples: NDArray[np.int64]

    def none(self) -> Exposures:
        """Return the same with all photos equally bright."""
        return replace(self, photos=tuple(no_exposure() for _ in self.photos), after=self.before)

    def without(self, wrong: Container[int]) -> Exposures:
        """Return those of all photos but some, by their numbers."""
        rest = [i for i in range(len(self.photos)) if i not in wrong]
        return replace(
            self,
            photos=tuple(self.photos[i] for i in rest),
            differences=self.differences[rest],
            samples=self.samples[rest],
        )


def exposures(
    views: NDArray[np.int32], colors: NDArray[np.uint8], radii2: NDArray[np.float32], count: int
) -> Exposures:
    """Find how bright photos are from points that several of them show.

    Parameters
    ----------
    views : (n, k) the photo of each sample of a point, -1 for none.
    colors : (n, k, 3) its levels.
    radii2 : (n, k) squared distance from the photo's middle, 1 in its corners.
    count : photos.
    """
    found = _solved(views, colors, radii2, count, vignetted=True)
    corner = _light_at(np.ones(1), found.photos[0].vignette)[0]
    if abs(1 - corner) >= _LEAST_VIGNETTE:
        return found
    return _solved(views, colors, radii2, count, vignetted=False)


def _solved(
    views: NDArray[np.int32],
    colors: NDArray[np.uint8],
    radii2: NDArray[np.float32],
    count: int,
    *,
    vignetted: bool,
) -> Exposures:
    step = max(len(views) // _MOST_POINTS, 1)
    views, colors, radii2 = views[::step], colors[::step], radii2[::step]
    usable = (views >= 0) & (colors.min(axis=2) >= _USABLE[0]) & (colors.max(axis=2) <= _USABLE[1])
    usable &= usable.sum(axis=1, keepdims=True) > 1
    point, place = np.nonzero(usable)
    if not len(point):
        none = tuple(no_exposure() for _ in range(count))
        return Exposures(none, 0.0, 0.0, np.zeros(count), np.zeros(count, np.int64))
    view = views[point, place].astype(np.int64)
    radius2 = radii2[point, place].astype(np.float64)
    level = colors[point, place].astype(np.float64)
    _, point = np.unique(point, return_inverse=True)
    samples = np.bincount(view, minlength=count)
    known = samples >= _LEAST_SAMPLES
    gain, bias = np.ones((count, 3)), np.zeros((count, 3))
    vignette = _NO_VIGNETTE
    weight = np.ones_like(level)
    before = 0.0
    for turn in range(_ROUNDS + 1):
        light = _light_at(radius2, vignette)[:, None]
        mean = _means(point, (level / light - bias[view]) / gain[view], weight * gain[view] ** 2)
        shown = gain[view] * mean[point] + bias[view]
        difference = np.abs(level - shown * light)
        if turn == 0:
            before = float(np.median(difference))
        if turn == _ROUNDS:
            break
        weight = np.minimum(1.0, _HUBER / np.maximum(difference, 1e-9))
        if vignetted:
            vignette = _vignette(shown, level, weight, radius2)
        level_there = level / _light_at(radius2, vignette)[:, None]
        gain, bias = _fitted(view, mean[point], level_there, weight, count)
        gain[~known], bias[~known] = 1.0, 0.0
        if known.any():
            # Only ratios are seen: the mean stays as it is.
            gain[known] /= np.exp(np.log(gain[known]).mean(axis=0))
            bias[known] -= bias[known].mean(axis=0)
    largest = difference.max(axis=1)
    each = [largest[view == number] for number in range(count)]
    return Exposures(
        photos=tuple(Exposure(gain[i], bias[i], vignette) for i in range(count)),
        before=before,
        after=float(np.median(difference)),
        differences=np.array([float(np.median(one)) if len(one) else 0.0 for one in each]),
        samples=samples,
    )


def _vignette(shown: Floats, level: Floats, weight: Floats, radius2: Floats) -> tuple[float, float, float]:
    """Fit level = shown · (1 + v₁ r² + v₂ r⁴) by least squares, held to 0; then make the mean 1."""
    rows = [shown * radius2[:, None], shown * radius2[:, None] ** 2]
    normal = np.array([[float((weight * a * b).sum()) for a in rows] for b in rows])
    right = np.array([float((weight * a * (level - shown)).sum()) for a in rows])
    prior = _PRIOR_SAMPLES * _PRIOR_LEVELS**2
    found = np.linalg.solve(normal + prior * np.eye(2), right)
    # Over a photo r² is 1/3 in the mean, and r⁴ some 1/6: the mean of the light is 1 there.
    return (1 / float(1 + found[0] / 3 + found[1] / 6), float(found[0]), float(found[1]))


def _means(index: NDArray[np.int64], values: Floats, weight: Floats) -> Floats:
    total = [np.asarray(np.bincount(index, weight[:, k]), np.float64) for k in range(3)]
    sums = [np.bincount(index, weight[:, k] * values[:, k]) for k in range(3)]
    return np.stack([s / np.maximum(t, 1e-12) for s, t in zip(sums, total, strict=True)], axis=1)


def _fitted(
    view: NDArray[np.int64], mean: Floats, level: Floats, weight: Floats, count: int
) -> tuple[Floats, Floats]:
    """Fit level = gain · mean + bias for each photo and channel by least squares, held to 1 and 0."""
    gain, bias = np.ones((count, 3)), np.zeros((count, 3))
    for k in range(3):
        a, y, w = mean[:, k], level[:, k], weight[:, k]

        def total(values: Floats) -> Floats:
            return np.asarray(np.bincount(view, values, minlength=count), np.float64)

        n, sa, sy = total(w), total(w * a), total(w * y)
        middle = np.divide(sa, n, out=np.full(count, 128.0), where=n > 0)
        saa = total(w * (a - middle[view]) ** 2) + _PRIOR_SAMPLES * _PRIOR_LEVELS**2
        say = total(w * (a - middle[view]) * y) + _PRIOR_SAMPLES * _PRIOR_LEVELS**2
        gain[:, k] = (say / saa).clip(1 / _MOST_GAIN, _MOST_GAIN)
        bias[:, k] = (sy - gain[:, k] * sa) / (n + _PRIOR_SAMPLES)
    return gain, bias


def _radii2(width: int, height: int) -> Floats:
    x, y = (np.linspace(-1, 1, size) for size in (width, height))
    aspect = height / width
    return np.asarray((x[None, :] ** 2 + (aspect * y[:, None]) ** 2) / (1 + aspect**2))


def _light_at(radii2: Floats, vignette: tuple[float, float, float]) -> Floats:
    """Return the vignette at squared distances from the middle, 1 in the corners."""
    return np.asarray(vignette[0] * (1 + vignette[1] * radii2 + vignette[2] * radii2**2))
