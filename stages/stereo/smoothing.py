"""Disparity smoothed along the edges of the image: the weighted least squares filter of ximgproc.

Min et al., "Fast global image smoothing based on weighted least squares", 2014. Pixels that fail the
filter's own left–right check are filled in from their surroundings: a picture, not a measurement.
"""

from __future__ import annotations

import numpy as np

from scanloom.stages.scans.model.scan import ColorImage
from scanloom.stages.stereo.matching import Disparity16


def smoothed(
    left: Disparity16,
    right: Disparity16,
    guide: ColorImage,
    *,
    block_size: int,
    strength: float,
    edge_sigma: float,
) -> Disparity16:
    """Return the left disparity smoothed where the left image is, dense.

    Parameters
    ----------
    left, right : int16, 1/16 px, as `Matcher.left` and `Matcher.right` return them.
    guide : the left image.
    block_size : of the matcher, whose blocks blur disparity beside its jumps.
    strength, edge_sigma : the filter's λ, and its σ in grey levels.
    """
    import cv2

    wls = cv2.ximgproc.createDisparityWLSFilterGeneric(True)
    wls.setLambda(strength)
    wls.setSigmaColor(edge_sigma)
    wls.setDepthDiscontinuityRadius((block_size + 1) // 2)
    return np.asarray(wls.filter(left, guide, disparity_map_right=right), np.int16)
