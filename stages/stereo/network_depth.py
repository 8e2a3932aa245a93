"""Depth from a user-supplied neural network.

Its results pass the same checks as the results of the built-in matchers. A stereo network also runs on the
mirrored pair, which gives the disparity of the right image. Pixels that fail the left–right check, small
components and plain pixels are removed. The remaining pixels get the confidence of
`scanloom.stages.stereo.disparity_confidence`.

The output of a monocular network is fitted to measured depth in scale and shift. It only fills pixels without
measured depth.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.stereo.codes import DEPTH_NETWORK_NO_EFFECT, DEPTH_NETWORK_SIDECAR_INVALID
from scanloom.stages.stereo.depth_filling import fill_depth
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.disparity_confidence import compute_confidence
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.networks.sidecar import INVERSE_DEPTH
from scanloom.stages.stereo.opencv_matching import (
    SUBPIXELS,
    SearchRange,
    compute_left_right_residual,
    mask_matched_pixels,
    mask_textured_pixels,
)
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.rectify import RectifiedRig

RESULT_VERSION = 1

Image = NDArray[np.uint8]
Map = NDArray[np.float32]

# Parameters without effect if a network replaces the matcher.
_MATCHER_PARAMETERS = ("matcher", "sgbm")
# Ratio of matched pixels below which the sidecar is probably wrong, not the network.
_MIN_MATCHED_RATIO = 0.01
# Number of evenly sampled pixels for scale and shift; the repeated median compares all pairs of them.
_SAMPLE_COUNT = 600
# Minimum number of measured pixels for a fit of scale and shift.
_MIN_MEASURED_PIXELS = 200
# Quantile of measured values ignored at either end. Depth outside the remaining range is not filled, because
# the fit does not constrain the network there.
_OUTLIER_QUANTILE = 0.01


def load_network(params: DepthParams) -> Network | None:
    """Load the network given by `model`, if any.

    A scan loads it once.

    Raises
    ------
    InputError, UsageError
        As `Network`; UsageError also for parameters without effect with a stereo network.
    """
    if params.model is None:
        return None
    network = Network(Path(params.model), round(params.model_memory * 1e6), params.model_seconds)
    if network.is_stereo:
        params.require_default(_MATCHER_PARAMETERS, "a stereo network (model)")
    return network


def compute_network_disparity(
    network: Network,
    left: Image,
    right: Image,
    rig: RectifiedRig,
    search: SearchRange,
    params: DepthParams,
) -> tuple[Map, NDArray[np.uint8]]:
    """Compute the disparity of a pair with a stereo network.

    Parameters
    ----------
    left, right : (h, w, 3) RGB or (h, w) grey uint8, rectified.
    search : valid disparities; others are dropped.

    Returns
    -------
    Disparity, (h, w) float32 px, NaN where missing, and confidence, (h, w) uint8.

    Raises
    ------
    InputError
        If the network cannot be run.
    """
    found = network.predict_pair(left, right, rig.focal_baseline, rig.principal_offset)
    first = _to_fixed_point(found.left, search, SUBPIXELS * (search.lowest - 1))
    residual = compute_left_right_residual(
        first, -_to_fixed_point(found.right, search, SUBPIXELS * search.end), search
    )
    matched = mask_matched_pixels(
        first,
        residual,
        search,
        tolerance=params.left_right_tolerance,
        speckle_size=params.speckle_size,
        speckle_range=params.speckle_range,
    )
    matched &= mask_textured_pixels(left if left.ndim == 2 else _to_grey(left), params.min_texture)
    trust = compute_confidence(first, residual, matched, search)
    trust = np.rint(trust * found.confidence).astype(np.uint8)
    return np.where(matched, found.left, np.float32(np.nan)), trust


def report_agreement(network: Network, confidence_map: NDArray[np.uint8]) -> None:
    """Warn if almost no pixel passes the left–right check of a network."""
    if np.count_nonzero(confidence_map) < _MIN_MATCHED_RATIO * confidence_map.size:
        emit(
            DEPTH_NETWORK_SIDECAR_INVALID.warning(
                "almost no pixel passes the left–right check with this network",
                DiagnosticLocation(file=network.file.name),
                remedy=(
                    "check unit, sign, range and inputs in its sidecar, or guess them with scanloom lab probe"
                ),
            )
        )


def fill_missing_depth(measured: DepthMap, network: Network, params: DepthParams) -> DepthMap:
    """Fill missing depth with a monocular network.

    The network's output has an unknown scale and shift. Both are fitted to measured pixels with the repeated
    median (Siegel 1982), which tolerates up to half of the pixels as outliers. If the fit fails, the map is
    returned unchanged and a warning is emitted.

    Raises
    ------
    InputError
        If the network cannot be run.
    """
    from scipy.stats import siegelslopes

    prediction, mirrored = network.predict_image(measured.color)
    is_inverse = network.sidecar.unit == INVERSE_DEPTH
    known = np.flatnonzero((measured.depth > 0) & np.isfinite(prediction))
    unchanged = replace(measured, filled=np.zeros(measured.depth.shape, bool))
    if len(known) < _MIN_MEASURED_PIXELS:
        _report_no_effect(network, "too few pixels have measured depth to fit it")
        return unchanged
    depth, values = (
        measured.depth.ravel()[known].astype(np.float64),
        prediction.ravel()[known].astype(np.float64),
    )
    wanted = 1 / depth if is_inverse else depth
    chosen = np.linspace(0, len(known) - 1, min(_SAMPLE_COUNT, len(known))).astype(int)
    scale, shift = siegelslopes(wanted[chosen], values[chosen])
    error = float(np.median(np.abs(scale * values + shift - wanted) / wanted))
    if not scale > 0 or not error <= params.model_error:
        reason = (
            "its median error exceeds depth.model_error"
            if scale > 0
            else "its depth order is inverted; check unit and sign in its sidecar"
        )
        _report_no_effect(network, reason)
        return unchanged
    with np.errstate(all="ignore"):
        fitted, other = (np.float32(scale) * one + np.float32(shift) for one in (prediction, mirrored))
        agrees = np.abs(fitted - other) <= np.float32(params.model_error) * fitted
        low, high = np.quantile(values, (_OUTLIER_QUANTILE, 1 - _OUTLIER_QUANTILE))
        filled = (measured.depth == 0) & agrees & (prediction >= low) & (prediction <= high)
        filled_depth = np.where(filled, 1 / fitted if is_inverse else fitted, measured.depth)
    filled &= (filled_depth >= measured.min_depth) & (filled_depth <= measured.max_depth)
    return fill_depth(measured, np.where(filled, filled_depth, 0).astype(np.float32))


def _report_no_effect(network: Network, why: str) -> None:
    # Without image names, so that a scan reports the warning only once.
    emit(
        DEPTH_NETWORK_NO_EFFECT.warning(
            "the network fills no depth in some images: {why}",
            DiagnosticLocation(file=network.file.name),
            why=why,
        )
    )


def _to_fixed_point(disparity: Map, search: SearchRange, none: int) -> NDArray[np.int16]:
    """Convert disparity to the matchers' fixed point, 1/16 px.

    Values out of range become `none`.
    """
    with np.errstate(invalid="ignore"):
        there = (disparity >= search.lowest) & (disparity < search.end)
    return np.where(there, np.rint(SUBPIXELS * np.where(there, disparity, 0)), none).astype(np.int16)


def _to_grey(image: Image) -> Image:
    import cv2

    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
