"""Phone scans: low-resolution depth registered to colour, with confidence levels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import SCAN_CONFIDENCE, SCAN_PHONE_IMAGES
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, scale_camera

# Relative tolerance of the aspect ratio: 1920×1440 and 256×192 agree exactly; 4032×3024 cropped to 16:9
# differs more.
_ASPECT_RATIO_TOLERANCE = 0.02


def scale_to_size(camera: Camera, size: tuple[int, int], label: str, path: Path) -> Camera:
    """Scale a camera to another image size, same field of view.

    Parameters
    ----------
    size : (width, height) in pixels.
    label : name of the images in the error message.
    path : file in the error message.

    Raises
    ------
    InputError
        If the aspect ratio differs: the images are then cropped or rotated, and have another camera.
    """
    width, height = size
    if abs(width * camera.height / (height * camera.width) - 1) > _ASPECT_RATIO_TOLERANCE:
        remedy = (
            " The images are rotated by 90°: rotate them back."
            if (width < height) != (camera.width < camera.height)
            else " Export the images again without cropping."
        )
        raise InputError(
            SCAN_PHONE_IMAGES,
            (
                "the size of {what} is {width}×{height} pixels, but the camera has another aspect ratio "
                "({camera_width}×{camera_height}).{turned}"
            ),
            path,
            what=label,
            width=width,
            height=height,
            camera_width=camera.width,
            camera_height=camera.height,
            turned=remedy,
        )
    return scale_camera(camera, width, height)


def resolve_min_confidence(options: ReadingParams, levels: Sequence[int], folder: Path) -> int:
    """Return the minimum confidence of valid depth, and report the choice.

    Parameters
    ----------
    levels : confidence levels of the layout, ascending (low, medium, high).

    Raises
    ------
    InputError
        If the user asks for more than the highest level, which would discard all depth.
    """
    min_confidence = levels[1] if options.min_confidence is None else options.min_confidence
    if min_confidence > levels[-1]:
        raise InputError(
            SCAN_CONFIDENCE,
            (
                "min_confidence is {least}, but this layout has only the levels {map}; set "
                "scan.min_confidence={levels} to keep only the highest level."
            ),
            folder,
            least=min_confidence,
            map=", ".join(map(str, levels)),
            levels=levels[-1],
        )
    emit(
        SCAN_CONFIDENCE.warning(
            "depth of confidence {least} or higher (levels {levels}) is used: "
            "scan.min_confidence={highest} keeps only the highest level, "
            "scan.min_confidence={lowest} keeps everything. Depth of phones is unreliable beyond 5 "
            "m; fuse.max_depth=5 ignores it",
            least=min_confidence,
            levels=", ".join(map(str, levels)),
            highest=levels[-1],
            lowest=levels[0],
        )
    )
    return min_confidence
