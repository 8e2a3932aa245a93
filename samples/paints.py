"""Procedural colours of made scenes: noise, grain and mixtures as functions of 3-D points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


def compute_noise(points: Floats, wavelength: float, seed: int) -> Floats:
    """Compute smooth value noise (n,), -1..1, on a cubic lattice.

    Parameters
    ----------
    wavelength : lattice spacing, metres.
    """
    q = points / wavelength + 1000.0
    cell = np.floor(q).astype(np.int64)
    f = q - cell
    f = f * f * (3 - 2 * f)
    total = np.zeros(len(points))
    for dx, dy, dz in np.ndindex(2, 2, 2):
        weight = np.abs(1 - dx - f[:, 0]) * np.abs(1 - dy - f[:, 1]) * np.abs(1 - dz - f[:, 2])
        total += weight * hash_lattice(cell + np.array((dx, dy, dz)), seed)
    return total


def hash_lattice(cell: Ints, seed: int) -> Floats:
    """Hash lattice points to fixed pseudo-random numbers, -1..1."""
    h = (cell[:, 0] * 73856093) ^ (cell[:, 1] * 19349663) ^ (cell[:, 2] * 83492791) ^ (seed * 2654435761)
    h = (h ^ (h >> 13)) * 1274126177 & 0xFFFFFFFF
    return ((h ^ (h >> 16)) & 0xFFFF) / 32767.5 - 1


def compute_grain(points: Floats, seed: int) -> Floats:
    """Compute noise (n, 1), about -1..1, of several wavelengths.

    The wavelengths range from 5 mm to 5 cm.
    """
    octaves = [(0.05, 0.3), (0.022, 0.35), (0.011, 0.45), (0.0055, 0.4)]
    grain = np.zeros(len(points))
    for k, (wavelength, weight) in enumerate(octaves):
        grain += weight * compute_noise(points, wavelength, seed + k)
    return grain[:, None]


def mix(mask: NDArray[np.bool_] | Floats, inside: Floats, outside: Floats) -> Floats:
    """Blend two colours (n, 3) or (3,) by a mask or ratio (n,)."""
    share = np.asarray(mask, np.float64).reshape(-1, 1)
    return np.asarray(share * inside + (1 - share) * outside)


def to_rgb(*levels: int) -> Floats:
    """Convert 8-bit levels to 0..1."""
    return np.array(levels) / 255
