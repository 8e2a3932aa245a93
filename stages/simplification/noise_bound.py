"""Bound on shape derived from the noise of a scanned surface."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.codes import USAGE_REGION_INVALID

# Quantiles between which deviations are used. Beyond the median, distant surface would lose shape that can be
# seen; few vertices are below the other one.
_QUANTILES = (0.1, 0.5)


def derive_noise_bound(deviations: NDArray[np.float64], factor: float) -> tuple[float, NDArray[np.float64]]:
    """Derive a bound on shape from the standard deviation of each vertex.

    With a texture and a factor of 2, held-out photos score within 0.1 dB of the unsimplified mesh
    (docs/measured.md).

    Parameters
    ----------
    deviations : (n,) metres, at least one of them positive.
    factor : number of standard deviations that a vertex may deviate.

    Returns
    -------
    The bound, `factor` times the median of the deviations, in metres; and the importance (n,) of each vertex,
    which divides the bound where the deviation is less than the median.
    """
    positive = deviations[deviations > 0]
    low, high = np.quantile(positive, _QUANTILES)
    return factor * float(high), np.asarray(high / deviations.clip(low, high))


def check_deviations(deviations: ArrayLike, vertex_count: int) -> NDArray[np.float64]:
    """Convert deviations to float64.

    Raises
    ------
    UsageError
        If their number is wrong, a value is negative or not finite, or all are 0.
    """
    values = np.asarray(deviations, np.float64)
    is_valid = values.shape == (vertex_count,) and bool((np.isfinite(values) & (values >= 0)).all())
    if not (is_valid and values.any()):
        raise UsageError(
            USAGE_REGION_INVALID,
            "deviations must be one finite number for each of the {count:,} vertices, at least 0, not all 0.",
            count=vertex_count,
        )
    return values
