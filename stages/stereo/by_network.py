"""Depth by a network of the user's own, held to what our own has to pass.

Of a pair, the network is run on the mirrored pair too, which gives the right image's disparity; what both do
not agree on, small pieces and what is flat go, and the rest has the confidence of
`scanloom.stages.stereo.confidence`. Of one image, what it says is fitted to measured depth, and used only
where there is none.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.stereo.codes import DEPTH_NETWORK_NO_EFFECT, DEPTH_NETWORK_SIDECAR_INVALID
from scanloom.stages.stereo.confidence import confidence
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.filling import filled_with
from scanloom.stages.stereo.matching import SUBPIXELS, SearchRange, consistency, matched_pixels, textured
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.networks.sidecar import INVERSE_DEPTH
from scanloom.stages.stereo.params import DepthParams
from scanloom.stages.stereo.rectify import RectifiedRig

RESULT_VERSION = 1

Image = NDArray[np.uint8]
Map = NDArray[np.float32]

# Only the matchers know of these.
_OF_MATCHERS = ("matcher", "sgbm")
# If left and right agree on less of the image, its sidecar is wrong rather than the network.
_AGREEING = 0.01
# Scale and shift come from so many pixels, evenly taken: the repeated median looks at all pairs of them.
_SAMPLES = 600
# From fewer measured pixels they are not told.
_FEWEST = 200
# What is nearer or farther than all but this share of what was measured is not filled in: nothing tells how
# the network goes on there.
_STRAY = 0.01


def network_of(params: DepthParams) -> Network | None:
    """Return the network that the parameters name, if any; it is loaded once for a whole scan.

    Raises
    ------
    InputError, UsageError
        As `Network`, and for parameters that do nothing with a network of pairs.
    """
    if params.model is None:
        return None
    network = Network(Path(params.model), round(params.model_memory * 1e6), params.model_seconds)
    if network.is_stereo:
        params.require_default(_OF_MATCHERS, "a network of pairs (model)")
    return network


def network_disparity(
    network: Network,
    left: Image,
    right: Image,
    rig: RectifiedRig,
    search: SearchRange,
    params: DepthParams,
) -> tuple[Map, NDArray[np.uint8]]:
    """Return disparity, (h, w) float32 px, NaN where there is none, and confidence, by a network of pairs.

    Parameters
    ----------
    left, right : (h, w, 3) RGB or (h, w) grey uint8, whose rows correspond.
    search : disparities that can be; others are none.

    Raises
    ------
    InputError
        If the network cannot be run.
    """
    found = network.of_pair(left, right, rig.focal_baseline, rig.principal_offset)
    first = _fixed_point(found.left, search, SUBPIXELS * (search.lowest - 1))
    residual = consistency(first, -_fixed_point(found.right, search, SUBPIXELS * search.end), search)
    matched = matched_pixels(
        first,
        residual,
        search,
        tolerance=params.left_right_tolerance,
        speckle_size=params.speckle_size,
        speckle_range=params.speckle_range,
    )
    matched &= textured(left if left.ndim == 2 else _grey(left), params.min_texture)
    trust = confidence(first, residual, matched, search)
    trust = np.rint(trust * found.sure).astype(np.uint8)
    return np.where(matched, found.left, np.float32(np.nan)), trust


def report_agreement(network: Network, trust: NDArray[np.uint8]) -> None:
    """Warn if left and right hardly agree by a network of pairs, as its confidence shows."""
    if np.count_nonzero(trust) < _AGREEING * trust.size:
        emit(
            DEPTH_NETWORK_SIDECAR_INVALID.warning(
                "by this network left and right agree on next to nothing",
                Where(file=network.file.name),
                remedy=(
                    "look at unit, sign, range and inputs of its sidecar, or have it guessed: "
                    "scanloom lab probe"
                ),
            )
        )


def completed(measured: DepthMap, network: Network, params: DepthParams) -> DepthMap:
    """Fill in depth where there is none by a network of single images.

    What the network says is right but for a scale and a shift, which are the repeated median's (Siegel 1982)
    over measured pixels; up to half of them may be wrong. Where the network does not fit, that is emitted.

    Raises
    ------
    InputError
        If the network cannot be run.
    """
    from scipy.stats import siegelslopes

    told, mirrored = network.of_image(measured.color)
    is_inverse = network.sidecar.unit == INVERSE_DEPTH
    known = np.flatnonzero((measured.depth > 0) & np.isfinite(told))
    nothing = replace(measured, filled=np.zeros(measured.depth.shape, bool))
    if len(known) < _FEWEST:
        _report_no_effect(network, "there is too little measured depth to fit it to")
        return nothing
    depth, values = measured.depth.ravel()[known].astype(np.float64), told.ravel()[known].astype(np.float64)
    wanted = 1 / depth if is_inverse else depth
    chosen = np.linspace(0, len(known) - 1, min(_SAMPLES, len(known))).astype(int)
    scale, shift = siegelslopes(wanted[chosen], values[chosen])
    off = float(np.median(np.abs(scale * values + shift - wanted) / wanted))
    if not scale > 0 or not off <= params.model_error:
        why = (
            "it differs by more than depth.model_error allows"
            if scale > 0
            else "what it calls near is far; look at unit and sign of its sidecar"
        )
        _report_no_effect(network, why)
        return nothing
    with np.errstate(all="ignore"):
        fitted, other = (np.float32(scale) * one + np.float32(shift) for one in (told, mirrored))
        agrees = np.abs(fitted - other) <= np.float32(params.model_error) * fitted
        low, high = np.quantile(values, (_STRAY, 1 - _STRAY))
        filled = (measured.depth == 0) & agrees & (told >= low) & (told <= high)
        whole = np.where(filled, 1 / fitted if is_inverse else fitted, measured.depth)
    filled &= (whole >= measured.min_depth) & (whole <= measured.max_depth)
    return filled_with(measured, np.where(filled, whole, 0).astype(np.float32))


def _report_no_effect(network: Network, why: str) -> None:
    # Equal for all images, so that a scan reports it once.
    emit(
        DEPTH_NETWORK_NO_EFFECT.warning(
            "the network fills in nothing in some images: {why}", Where(file=network.file.name), why=why
        )
    )


def _fixed_point(disparity: Map, search: SearchRange, none: int) -> NDArray[np.int16]:
    """Return a disparity as the matchers have it, sixteenths of a pixel; what is out of range is `none`."""
    with np.errstate(invalid="ignore"):
        there = (disparity >= search.lowest) & (disparity < search.end)
    return np.where(there, np.rint(SUBPIXELS * np.where(there, disparity, 0)), none).astype(np.int16)


def _grey(image: Image) -> Image:
    import cv2

    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), np.uint8)
