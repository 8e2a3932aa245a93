"""Photos that belong to the smaller images of a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import decode_color, read_image_bytes, read_image_size
from scanloom.stages.scans.codes import SCAN_IMAGES_UNPAIRED
from scanloom.stages.scans.model.scan import Camera, PackedImage

# Networks round sizes to multiples of 14 pixels, so the shape of stretched images changes by less than this.
_MAX_STRETCH = 0.03
# Minimum correlation of a photo with the image of the network that was made from it.
_MIN_CORRELATION = 0.8
_CHECKED_VIEWS = 4


@dataclass(frozen=True)
class PhotoMapping:
    """Position of the image of a network in the photo.

    Attributes
    ----------
    size : (width, height) of the photo.
    scale : (2,) pixels of the photo per pixel of the network, across and down.
    start : (2,) left and top edge of the network's image in the photo, pixels; negative for a padded image.
    """

    size: tuple[int, int]
    scale: tuple[float, float]
    start: tuple[float, float]

    def apply(self, camera: Camera) -> Camera:
        """Return the camera of the photo for the camera of the network's image."""
        (sx, sy), (left, top) = self.scale, self.start
        return Camera(
            *self.size,
            camera.fx * sx,
            camera.fy * sy,
            (camera.cx + 0.5) * sx - 0.5 + left,
            (camera.cy + 0.5) * sy - 0.5 + top,
        )


def match_photos(
    photos: Sequence[Path],
    images: Sequence[PackedImage | Path | None],
    size: tuple[int, int],
    source: Path,
) -> list[PhotoMapping] | None:
    """Find the position of the network's image in each photo.

    Networks stretch photos to their size, crop them at the centre, or pad them to a square. Some views are
    compared with the photos.

    Parameters
    ----------
    photos : in the order of the views.
    images : the images of the network, if it stores them.
    size : (width, height) of the network's images.
    source : file with the views, for messages.

    Returns
    -------
    One mapping per view; None if the photos do not belong to the views, which is reported.
    """
    if not photos:
        return None
    if len(photos) != len(images):
        _report(source, photos, f"there are {len(photos):,} photos and {len(images):,} views")
        return None
    try:
        sizes = [read_image_size(photo) for photo in photos]
    except InputError as error:
        _report(source, photos, f"one cannot be read ({error.diagnostic})")
        return None
    candidates = [_list_mappings(one, size) for one in sizes]
    checked = [place for place, image in enumerate(images) if image is not None]
    checked = checked[:: max(1, len(checked) // _CHECKED_VIEWS)]
    if not checked:
        return [_choose_by_shape(options) for options in candidates]
    scores = np.zeros(len(candidates[0]))
    for place in checked:
        image, photo = _read_gray(images[place]), _read_gray(photos[place])
        scores += [_correlate(image, photo, mapping) for mapping in candidates[place]]
    best = int(np.argmax(scores))
    if scores[best] < _MIN_CORRELATION * len(checked):
        _report(source, photos, "they show something else than the views")
        return None
    return [options[best] for options in candidates]


def _report(source: Path, photos: Sequence[Path], reason: str) -> None:
    emit(
        SCAN_IMAGES_UNPAIRED.warning(
            "the photos in {folder}/ are not used, because {reason}; the images in the file have fewer "
            "pixels",
            source,
            folder=photos[0].parent.name,
            reason=reason,
        )
    )


def _list_mappings(photo: tuple[int, int], size: tuple[int, int]) -> list[PhotoMapping]:
    """List the possible mappings: stretched, cropped at the centre, padded."""
    scales = (photo[0] / size[0], photo[1] / size[1])
    mappings = [PhotoMapping(photo, scales, (0.0, 0.0))]
    for scale in (min(scales), max(scales)):
        start = ((photo[0] - size[0] * scale) / 2, (photo[1] - size[1] * scale) / 2)
        mappings.append(PhotoMapping(photo, (scale, scale), start))
    return mappings


def _choose_by_shape(mappings: list[PhotoMapping]) -> PhotoMapping:
    """Choose stretched for nearly the same shape, else cropped."""
    across, down = mappings[0].scale
    return mappings[0] if abs(across / down - 1) < _MAX_STRETCH else mappings[1]


def _read_gray(image: PackedImage | Path | None) -> NDArray[np.uint8]:
    import cv2

    assert image is not None
    color = image.load() if isinstance(image, PackedImage) else decode_color(read_image_bytes(image), image)
    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)


def _correlate(image: NDArray[np.uint8], photo: NDArray[np.uint8], mapping: PhotoMapping) -> float:
    """Correlate the network's image with the photo, where both have pixels."""
    import cv2

    (sx, sy), (left, top) = mapping.scale, mapping.start
    height, width = image.shape
    # Blur like the reduction of the photo, so that fine patterns do not alias.
    soft = cv2.GaussianBlur(photo, (0, 0), 0.5 * max(sx, sy))
    matrix = np.array([[sx, 0, left + 0.5 * sx - 0.5], [0, sy, top + 0.5 * sy - 0.5]])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    resized = cv2.warpAffine(soft, matrix, (width, height), flags=flags).astype(np.float64)
    u, v = np.meshgrid(np.arange(width) * sx + left, np.arange(height) * sy + top)
    inside = (u >= 0) & (v >= 0) & (u < photo.shape[1]) & (v < photo.shape[0])
    a, b = image[inside].astype(np.float64), resized[inside]
    if a.size < 2:
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    return float(np.sum(a * b) / max(np.sqrt(np.sum(a * a) * np.sum(b * b)), 1e-9))
