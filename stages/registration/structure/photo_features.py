"""SIFT features of photos.

References
----------
Mikolajczyk and Schmid, "Scale & affine invariant interest point detectors", 2004; Dong and Soatto,
"Domain-size pooling in local descriptors: DSP-SIFT", 2015. Both are pycolmap's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.features import Keypoints, detect_keypoints, stretch_contrast
from scanloom.stages.scans.model.images import read_color, read_mask
from scanloom.stages.scans.model.scan import Camera, Frame

# Features per photo. Descriptors of all photos are in memory, 128 bytes each.
_MAX_FEATURES = 5000
# The same with affine shapes: the number counts features before several orientations and scales of each.
_MAX_AFFINE_FEATURES = 4000
# Contrast threshold of SIFT, lower than its default: smooth surfaces have no stronger features.
_CONTRAST = 0.02


@dataclass(frozen=True, eq=False)
class PhotoFeatures:
    """Features of a photo.

    Attributes
    ----------
    camera : camera of the photo at its full size.
    pixels : (n, 2) float64, column and row in the photo at full size; pixel centres at integers.
    descriptors : (k, 128) uint8 of the first k features, the strongest first. Learned features have none.
    colors : (n, 3) uint8 RGB.
    """

    camera: Camera
    pixels: NDArray[np.float64]
    descriptors: NDArray[np.uint8]
    colors: NDArray[np.uint8]


def detect_photo_features(frame: Frame, max_pixels: float, *, has_affine_shapes: bool) -> PhotoFeatures:
    """Detect the features of a photo, outside of its mask only.

    Parameters
    ----------
    max_pixels : larger photos are downscaled to this number of pixels first.
    has_affine_shapes : estimate the affine shapes of features, and pool their descriptors over scales. Such
        features match over larger differences in viewing direction, and take about five times as long.

    Raises
    ------
    InputError
        If the photo or its mask cannot be read.
    """
    photo = read_photo(frame, max_pixels)
    grey = photo.grey
    found = (
        _detect_affine_keypoints(grey)
        if has_affine_shapes
        else detect_keypoints(grey, _MAX_FEATURES, contrast=_CONTRAST)
    )
    order = np.argsort(-found.strength, kind="stable")
    pixels, kept, colors = photo.locate(found.pixels[order])
    return PhotoFeatures(frame.camera, pixels, np.ascontiguousarray(found.descriptors[order][kept]), colors)


@dataclass(frozen=True, eq=False)
class DownscaledPhoto:
    """A photo as its features are detected.

    Attributes
    ----------
    color : (h, w, 3) uint8 RGB.
    mask : (h, w) uint8, 0 where features are dropped; None without a mask.
    full_size : width and height of the photo, pixels.
    """

    color: NDArray[np.uint8]
    mask: NDArray[np.uint8] | None
    full_size: tuple[int, int]

    @property
    def grey(self) -> NDArray[np.uint8]:
        """The photo in grey (h, w)."""
        import cv2

        return np.asarray(cv2.cvtColor(self.color, cv2.COLOR_RGB2GRAY), np.uint8)

    def locate(
        self, pixels: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_], NDArray[np.uint8]]:
        """Locate features in the photo at full size.

        Returns
        -------
        pixels : (k, 2) of the features in the mask.
        kept : (n,) mask of these features.
        colors : (k, 3) uint8.
        """
        height, width = self.color.shape[:2]
        columns, rows = (pixels.round().astype(np.intp).clip(0, (width - 1, height - 1))).T
        kept = np.ones(len(pixels), bool) if self.mask is None else self.mask[rows, columns] > 0
        scale = self.full_size[0] / width, self.full_size[1] / height
        full = (pixels.astype(np.float64) + 0.5) * scale - 0.5
        return full[kept], kept, self.color[rows, columns][kept]


def read_photo(frame: Frame, max_pixels: float) -> DownscaledPhoto:
    """Read a photo and its mask, downscaled to a number of pixels.

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
    mask = read_mask(frame)
    if mask is not None:
        mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST), np.uint8)
    return DownscaledPhoto(color, mask, (width, height))


def _detect_affine_keypoints(grey: NDArray[np.uint8]) -> Keypoints:
    import pycolmap

    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu, options.num_threads = False, 1
    options.sift.max_num_features = _MAX_AFFINE_FEATURES
    options.sift.estimate_affine_shape = options.sift.domain_size_pooling = True
    # Matching converts descriptors of unit length to RootSIFT.
    options.sift.normalization = pycolmap.Normalization.L2
    extractor = pycolmap.FeatureExtractor.create(options)
    found, descriptors = extractor.extract(pycolmap.Bitmap.from_array(stretch_contrast(grey)))
    return Keypoints(
        # Pixel centres of COLMAP are at 0.5.
        np.array([(one.x - 0.5, one.y - 0.5) for one in found], np.float32).reshape(-1, 2),
        np.array(descriptors.data, np.uint8).reshape(-1, 128),
        np.array([one.compute_scale() for one in found], np.float32),
    )
