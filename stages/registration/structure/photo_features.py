"""SIFT features of photos."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import detect_keypoints
from scanloom.stages.scans.model.images import read_color, read_mask
from scanloom.stages.scans.model.scan import Camera, Frame

# Features per photo. Descriptors of all photos are in memory, 128 bytes each.
_MAX_FEATURES = 5000
# Contrast threshold of SIFT, lower than its default: smooth surfaces have no stronger features.
_CONTRAST = 0.02


@dataclass(frozen=True, eq=False)
class PhotoFeatures:
    """Features of a photo.

    Attributes
    ----------
    camera : camera of the photo at its full size.
    pixels : (n, 2) float64, column and row in the photo at full size; pixel centres at integers.
    descriptors : (n, 128) uint8, strongest feature first.
    colors : (n, 3) uint8 RGB.
    """

    camera: Camera
    pixels: NDArray[np.float64]
    descriptors: NDArray[np.uint8]
    colors: NDArray[np.uint8]


def detect_photo_features(frame: Frame, max_pixels: float) -> PhotoFeatures:
    """Detect the features of a photo, outside of its mask only.

    Parameters
    ----------
    max_pixels : larger photos are downscaled to this number of pixels first.

    Raises
    ------
    InputError
        If the photo or its mask cannot be read.
    """
    import cv2

    color = read_color(frame)
    assert color is not None
    height, width = color.shape[:2]
    scale = min(1.0, math.sqrt(max_pixels / (width * height)))
    size = max(1, round(width * scale)), max(1, round(height * scale))
    if size != (width, height):
        color = np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)
    found = detect_keypoints(
        np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8), _MAX_FEATURES, contrast=_CONTRAST
    )
    order = np.argsort(-found.strength, kind="stable")
    pixels = found.pixels[order].astype(np.float64)
    columns, rows = (pixels.round().astype(np.intp).clip(0, (size[0] - 1, size[1] - 1))).T
    kept = np.ones(len(pixels), bool)
    mask = read_mask(frame)
    if mask is not None:
        mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
        kept = mask[rows, columns] > 0
    full = (pixels + 0.5) * (width / size[0], height / size[1]) - 0.5
    return PhotoFeatures(
        frame.camera,
        full[kept],
        np.ascontiguousarray(found.descriptors[order][kept]),
        color[rows, columns][kept],
    )
