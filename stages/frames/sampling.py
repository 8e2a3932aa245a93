"""Even sampling of frames and points."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def sample_evenly(count: int, max_count: int) -> NDArray[np.int64]:
    """Choose up to `max_count` indices spread evenly over `count` items.

    Returns
    -------
    (n,) ascending indices, each once. They include the first and the last item if `max_count` is at least 2.
    """
    indices = np.linspace(0, count - 1, min(count, max_count)).round().astype(np.int64)
    return np.asarray(np.unique(indices))
