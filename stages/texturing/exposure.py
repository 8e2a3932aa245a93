"""How bright each photo is: a gain and a bias for each channel, and one vignette for all.

A level of photo i is taken for (gain_i · a + bias_i) · v(r), with a what all photos have in common and
v(r) = v₀ (1 + v₁ r² + v₂ r⁴) of the distance from the photo's middle, 1 in the mean over a photo (Goldman
2010, "Vignette and exposure calibration and compensation", equation 1 without the response curve). White
balance is part of it, since channels are apart.
"""

from __future__ import annotations

import functools
from collections.abc import Container, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_ROUNDS = 6
# Points are enough for all photos of a scan, and to tell whether there is a vignette.
_MOST_POINTS, _FEW_POINTS = 40_000, 10_000
# Levels beyond which a difference counts less and less (Huber), and levels that are cut off.
_HUBER = 8.0
_USABLE = (4.0, 250.0)
# What holds a photo to gain 1 and bias 0: as so many samples would, of this spread in levels.
_PRIOR_SAMPLES, _PRIOR_LEVELS = 30.0, 40.0
_MOST_GAIN = 4.0
# Of the light in the corners: a weaker vignette averages out, and photos look as people know them.
_LEAST_VIGNETTE = 0.1
# Light in the corners beside that in the middle: less or more is no lens's, but of a thing in the middle of
# all photos, which says nothing of their corners.
_LEAST_LIGHT, _MOST_LIGHT = 0.2, 1.5
_NO_VIGNETTE = (1.0, 0.0, 0.0)
# Fewer samples in other photos than this tell nothing.
_LEAST_SAMPLES = 50
# Of a photo, that are corrected at a time.
_ROWS = 32


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
        # All channels of a row beside each other, a few rows at a time: the memory stays where it is quick.
        gain, bias = (np.tile(one, width) for one in (self.gain, self.bias))
        corrected = np.empty_like(image)
        for start in range(0, height, _ROWS):
            rows = slice(start, start + _ROWS)
            light = _light_at(_radii2(width, height, rows), self.vignette).repeat(3, axis=1)
            levels = image[rows].reshape(light.shape) / light
            levels -= bias
            levels /= gain
            np.rint(levels, out=levels)
            corrected[rows] = levels.clip(0, 255, out=levels).reshape(corrected[rows].shape)
        return corrected

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
    step = max(len(views) // _FEW_POINTS, 1)
    found = _solved(views[::step], colors[::step], radii2[::step], count, vignetted=True)
    middle, corner = _light_at(np.array([0.0, 1.0]), found.photos[0].vignette)
    is_of_lens = _LEAST_LIGHT * middle <= corner <= _MOST_LIGHT * middle
    is_vignetted = bool(is_of_lens and abs(1 - corner) >= _LEAST_VIGNETTE)
    return _solved(views, colors, radii2, count, vignetted=is_vignetted)


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
    # An array for each channel: rows of three are slow.
    levels = [colors[point, place, k].astype(np.float64) for k in range(3)]
    # They are in order.
    point = np.cumsum(np.diff(point, prepend=point[0]) > 0)
    samples = np.bincount(view, minlength=count)
    known = samples >= _LEAST_SAMPLES
    # Of each channel.
    gain, bias = np.ones((3, count)), np.zeros((3, count))
    vignette = _NO_VIGNETTE
    weights = [np.ones_like(radius2)] * 3
    before = 0.0
    for turn in range(_ROUNDS + 1):
        light = _light_at(radius2, vignette)
        there = [level / light for level in levels]
        gains, biases = ([np.take(one, view) for one in of] for of in (gain, bias))
        means = [_mean(point, there[k], weights[k], gains[k], biases[k])[point] for k in range(3)]
        shown = [gains[k] * means[k] + biases[k] for k in range(3)]
        differences = [np.abs(levels[k] - shown[k] * light) for k in range(3)]
        if turn == 0:
            before = float(np.median(differences))
        if turn == _ROUNDS:
            break
        weights = [np.minimum(1.0, _HUBER / np.maximum(one, 1e-9)) for one in differences]
        if vignetted:
            vignette = _vignette(shown, levels, weights, radius2)
            light = _light_at(radius2, vignette)
            there = [level / light for level in levels]
        for k in range(3):
            gain[k], bias[k] = _fitted(view, means[k], there[k], weights[k], count)
        gain[:, ~known], bias[:, ~known] = 1.0, 0.0
        if known.any():
            # Only ratios are seen: the mean stays as it is. What all have in common is scaled and shifted for
            # that, so that each photo's bias moves by its own gain.
            gain[:, known] /= np.exp(np.log(gain[:, known]).mean(axis=1, keepdims=True))
            middle = bias[:, known].mean(axis=1, keepdims=True) / gain[:, known].mean(axis=1, keepdims=True)
            bias[:, known] -= gain[:, known] * middle
    largest = functools.reduce(np.maximum, differences)
    by_view = np.argsort(view, kind="stable")
    each = np.split(largest[by_view], np.cumsum(samples)[:-1])
    return Exposures(
        photos=tuple(Exposure(gain[:, i].copy(), bias[:, i].copy(), vignette) for i in range(count)),
        before=before,
        after=float(np.median(differences)),
        differences=np.array([float(np.median(one)) if len(one) else 0.0 for one in each]),
        samples=samples,
    )


def _vignette(
    shown: Sequence[Floats], levels: Sequence[Floats], weights: Sequence[Floats], radius2: Floats
) -> tuple[float, float, float]:
    """Fit level = shown · (1 + v₁ r² + v₂ r⁴) by least squares, held to 0; then make the mean 1."""
    normal = _PRIOR_SAMPLES * _PRIOR_LEVELS**2 * np.eye(2)
    right = np.zeros(2)
    for bright, level, weight in zip(shown, levels, weights, strict=True):
        rows = [bright * radius2, bright * radius2**2]
        weighted = [weight * row for row in rows]
        normal += [[float((a * b).sum()) for a in rows] for b in weighted]
        right += [float((a * (level - bright)).sum()) for a in weighted]
    found = np.linalg.solve(normal, right)
    # Over a photo r² is 1/3 in the mean, and r⁴ some 1/6: the mean of the light is 1 there.
    return (1 / float(1 + found[0] / 3 + found[1] / 6), float(found[0]), float(found[1]))


def _mean(point: NDArray[np.int64], there: Floats, weight: Floats, gain: Floats, bias: Floats) -> Floats:
    """Return what the samples of each point have in common."""
    weight = weight * gain**2
    total = np.bincount(point, weight)
    return np.asarray(np.bincount(point, weight * ((there - bias) / gain)) / np.maximum(total, 1e-12))


def _fitted(
    view: NDArray[np.int64], mean: Floats, level: Floats, weight: Floats, count: int
) -> tuple[Floats, Floats]:
    """Fit level = gain · mean + bias for each photo by least squares, held to 1 and 0."""

    def total(values: Floats) -> Floats:
        return np.asarray(np.bincount(view, values, minlength=count), np.float64)

    n, sa, sy = total(weight), total(weight * mean), total(weight * level)
    middle = np.divide(sa, n, out=np.full(count, 128.0), where=n > 0)
    off = mean - middle[view]
    saa = total(weight * off**2) + _PRIOR_SAMPLES * _PRIOR_LEVELS**2
    say = total(weight * off * level) + _PRIOR_SAMPLES * _PRIOR_LEVELS**2
    gain = (say / saa).clip(1 / _MOST_GAIN, _MOST_GAIN)
    return gain, (sy - gain * sa) / (n + _PRIOR_SAMPLES)


def _radii2(width: int, height: int, rows: slice) -> Floats:
    x, y = (np.linspace(-1, 1, size) for size in (width, height))
    aspect = height / width
    return np.asarray((x[None, :] ** 2 + (aspect * y[rows, None]) ** 2) / (1 + aspect**2))


def _light_at(radii2: Floats, vignette: tuple[float, float, float]) -> Floats:
    """Return the vignette at squared distances from the middle, 1 in the corners."""
    return np.asarray(vignette[0] * (1 + vignette[1] * radii2 + vignette[2] * radii2**2))
