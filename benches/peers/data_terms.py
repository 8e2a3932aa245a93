"""Data terms of regularised fields on voxels: absolute and squared differences.

References
----------
Zach, "Fast and high quality fusion of depth maps", 2008 (histograms); Rudin, Osher and Fatemi, "Nonlinear
total variation based noise removal algorithms", 1992 (squares).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


class DataTerm(Protocol):
    """Cost of a field that differs from the measurements."""

    def compute_mean(self) -> Floats:
        """Compute the weighted mean (n,) of all measurements."""

    def compute_cost(self, field: Floats) -> float:
        """Compute the cost of a field (n,), summed over all voxels."""

    def apply_proximal(self, field: Floats, step: float) -> Floats:
        """Minimise |v − field|² / 2 + step × cost(v) for each voxel; return v (n,)."""


@dataclass(frozen=True, eq=False)
class Histograms:
    """Weighted absolute differences to the bins of a histogram of each voxel.

    The cost of a voxel is Σ_b n_b |u − c_b| over bins with mean c and weight n.

    Attributes
    ----------
    levels : (bins, n) mean of each bin, ascending along the bins; any value inside the bin if it is empty.
    weights : (bins, n) weight of each bin, 0 if it is empty.
    """

    levels: Floats
    weights: Floats

    def compute_mean(self) -> Floats:
        """Compute the weighted mean (n,) of all measurements."""
        total = np.einsum("bn,bn->n", self.levels, self.weights)
        return np.asarray(total / self.weights.sum(axis=0))

    def compute_cost(self, field: Floats) -> float:
        """Compute the sum of the weighted absolute differences to a field (n,)."""
        costs = (
            float(np.vdot(weights, np.abs(field - levels)))
            for levels, weights in zip(self.levels, self.weights, strict=True)
        )
        return sum(costs)

    def apply_proximal(self, field: Floats, step: float) -> Floats:
        """Minimise |v − field|² / 2 + step × cost(v) for each voxel; return v (n,).

        Between two levels the minimum is the field plus a shift that the weights on both sides determine. The
        shift falls from level to level, so a maximum of minima selects the right interval.
        """
        shifted = field + np.float32(step) * self.weights.sum(axis=0)
        best: Floats = np.minimum(shifted, self.levels[0])
        for number, weights in enumerate(self.weights):
            shifted -= np.float32(2 * step) * weights
            is_last = number + 1 == len(self.levels)
            np.maximum(best, shifted if is_last else np.minimum(shifted, self.levels[number + 1]), out=best)
        return best


@dataclass(frozen=True, eq=False)
class SquaredDifferences:
    """Weighted squared differences to the mean of the measurements of each voxel.

    The cost of a voxel is n (u − c)² / 2.

    Attributes
    ----------
    means, weights : (n,) mean c and total weight n of the measurements.
    """

    means: Floats
    weights: Floats

    @classmethod
    def from_histograms(cls, histograms: Histograms) -> SquaredDifferences:
        """Take the mean and total weight of histograms."""
        return cls(histograms.compute_mean(), histograms.weights.sum(axis=0))

    def compute_mean(self) -> Floats:
        """Return the means (n,)."""
        return self.means

    def compute_cost(self, field: Floats) -> float:
        """Compute the sum of the weighted squared differences to a field (n,), halved."""
        return float(np.vdot(self.weights, (field - self.means) ** 2)) / 2

    def apply_proximal(self, field: Floats, step: float) -> Floats:
        """Minimise |v − field|² / 2 + step × cost(v) for each voxel; return v (n,)."""
        pull = np.float32(step) * self.weights
        return np.asarray((field + pull * self.means) / (1 + pull))
