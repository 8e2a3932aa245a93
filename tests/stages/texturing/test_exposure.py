"""Exposures of photos, estimated from common points."""

from __future__ import annotations

import numpy as np
import pytest

from scanloom.stages.texturing.exposure import estimate_exposures


def make_samples(
    gains: np.ndarray, biases: np.ndarray, largest_radius2: float, light: tuple[float, float], seed: int = 0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Make observations of 3,000 points by four photos each: photo indices, levels, squared radii."""
    rng = np.random.default_rng(seed)
    count = 3000
    level = rng.uniform(40, 120, count)[:, None, None]
    views = np.stack([rng.permutation(len(gains))[:4] for _ in range(count)]).astype(np.int32)
    radii2 = rng.uniform(0, largest_radius2, views.shape).astype(np.float32)
    bright = 1 + light[0] * radii2 + light[1] * radii2**2
    colors = (level * gains[views][..., None] + biases[views][..., None]) * bright[..., None]
    noisy = colors + rng.normal(0, 1, (*views.shape, 3))
    return views, noisy.clip(0, 255).astype(np.uint8), radii2


def correct_grey(exposure: object, level: int = 80) -> np.ndarray:
    return exposure.correct(np.full((60, 80, 3), level, np.uint8))[30, 40]  # type: ignore[attr-defined]


def test_gains_and_biases_are_estimated() -> None:
    gains, biases = np.array([0.7, 0.9, 1.0, 1.1, 1.4]), np.array([8.0, -6.0, 0.0, 4.0, -6.0])
    found = estimate_exposures(*make_samples(gains, biases, 1.0, (0.0, 0.0)), count=5)
    usual = gains / np.exp(np.log(gains).mean())
    for one, gain in zip(found.photos, usual, strict=True):
        np.testing.assert_allclose(one.gain, gain, rtol=0.03)
    assert found.difference_after < 0.2 * found.difference_before
    # A common change of all photos cannot be estimated, so only equality is checked.
    shown = [
        correct_grey(one, round(80 * g + b)) for one, g, b in zip(found.photos, gains, biases, strict=True)
    ]
    assert np.ptp(np.stack(shown).astype(int), axis=0).max() <= 3
    assert np.mean(shown) == pytest.approx(80, rel=0.1)


def test_vignetting_is_estimated() -> None:
    found = estimate_exposures(*make_samples(np.ones(5), np.zeros(5), 1.0, (-0.3, -0.1)), count=5)
    v = found.photos[0].vignette
    assert 1 + v[1] + v[2] == pytest.approx(0.6, rel=0.1)


def test_an_object_in_the_centre_of_all_photos_gives_no_vignetting() -> None:
    """Brightness changes near the centre must not be extrapolated to the corners, where no data is."""
    found = estimate_exposures(*make_samples(np.ones(5), np.zeros(5), 0.05, (4.0, 10.0)), count=5)
    for one in found.photos:
        assert one.vignette == (1.0, 0.0, 0.0)
        np.testing.assert_allclose(correct_grey(one), 80, atol=12)
