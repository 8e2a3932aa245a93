"""Sub-plane refinement of plane-sweep depth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.stereo.view_images import ViewImage

Map = NDArray[np.float32]

# Width of the median filter before refinement, px; maximum difference that it replaces, in planes.
_MEDIAN_PX, _MAX_MEDIAN_STEPS = 5, 3


def refine_inverse_depth(
    main: ViewImage, partners: Sequence[ViewImage], inverse: Map, step: float, threads: int = 1
) -> Map:
    """Refine inverse depth by at most half a plane distance.

    Parameters
    ----------
    main, partners : view and partners with their images.
    inverse : (h, w) float32 1/m, from the sweep.
    step : distance between planes, 1/m.
    threads : thread count; results do not depend on it.

    Returns
    -------
    (h, w) float32 1/m.
    """
    import cv2

    # Single pixels that are a few planes off would spoil the windows around them; larger differences may be
    # thin objects.
    middle = np.asarray(cv2.medianBlur(inverse, _MEDIAN_PX), np.float32)
    inverse = np.where(np.abs(middle - inverse) <= _MAX_MEDIAN_STEPS * step, middle, inverse)
    images = [(main.view.compute_projection_to(one.view), one.grey) for one in partners]
    return _kernels.refine_inverse_depth(main.grey, images, inverse, step=step, wanted_threads=threads)
