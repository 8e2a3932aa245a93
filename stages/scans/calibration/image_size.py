"""Image size of a calibration, and scaling of its camera to the actual images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.table_values import flatten_numbers, to_finite_number
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_CALIBRATION_SCALED,
)
from scanloom.stages.scans.model.scan import Camera, scale_camera

# Keys of a size as two numbers, and of its sides.
_SIZE_KEYS = ("image_size", "imageSize", "img_size", "resolution", "size")
_SIDE_KEYS = (
    ("width", "height"),
    ("image_width", "image_height"),
    ("image_Width", "image_Height"),
    ("w", "h"),
)
MAX_SIDE_PX = 1 << 16
# Relative tolerance of aspect ratios: downscaling rounds the sides (1280×720 becomes 854×480).
_ASPECT_TOLERANCE = 0.01
# Maximum distance of a principal point from the image centre, as ratio of the image size.
_MAX_CENTRE_OFFSET_RATIO = 0.25
# Relative tolerance between the horizontal and vertical ratio of the principal point. If they agree, another
# image size is inferred from the principal point.
_FACTOR_TOLERANCE = 0.1


def get_stated_size(values: dict[str, Any], width: int, height: int, path: Path) -> tuple[int, int]:
    """Return the (width, height) in pixels that a table states, or the image size.

    Raises
    ------
    InputError
        If the stated size is implausible.
    """
    sides = next((names for names in _SIDE_KEYS if all(name in values for name in names)), None)
    pair = next((name for name in _SIZE_KEYS if name in values), None)
    if sides is not None:
        size = tuple(to_finite_number(values[name], name, path) for name in sides)
    elif pair is not None and not isinstance(values[pair], (int, float, str)):
        size = flatten_numbers(values[pair], pair, path)
    else:
        return width, height
    if len(size) != 2 or not all(1 <= side <= MAX_SIDE_PX for side in size):
        shown = "×".join(f"{side:g}" for side in size[:4])
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "its image size {shown} is implausible.",
            path,
            shown=shown,
        )
    return round(size[0]), round(size[1])


def scale_to_images(camera: Camera, width: int, height: int, path: Path) -> Camera:
    """Scale the camera of a calibration to the size of the images.

    Warns if the camera is scaled, or if its principal point is far from the image centre.

    Raises
    ------
    InputError
        If the aspect ratios differ: the images were cropped or rotated.
    """
    if (camera.width, camera.height) == (width, height):
        _warn_off_centre(camera, path)
        return camera
    if not has_same_aspect_ratio((camera.width, camera.height), (width, height)):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "it is for images of {camera_width}×{camera_height} px, but these are "
                "{width}×{height} px. The aspect ratio differs, so the images were cropped or "
                "rotated."
            ),
            path,
            remedy="Give the calibration of these images.",
            camera_width=camera.width,
            camera_height=camera.height,
            width=width,
            height=height,
        )
    emit(
        CAMERA_CALIBRATION_SCALED.warning(
            "it is for images of {camera_width}×{camera_height} px; its camera is scaled to these "
            "images of {width}×{height} px",
            path,
            camera_width=camera.width,
            camera_height=camera.height,
            width=width,
            height=height,
        )
    )
    return scale_camera(camera, width, height)


def has_same_aspect_ratio(first: tuple[int, int], second: tuple[int, int]) -> bool:
    """Return True if two sizes (width, height) have the same aspect ratio.

    If exactly one side is equal, the image was cropped, so the result is False.
    """
    if (first[0] == second[0]) != (first[1] == second[1]):
        return False
    return abs(first[0] * second[1] / (first[1] * second[0]) - 1) <= _ASPECT_TOLERANCE


def has_scaling_warning(diagnostics: Sequence[Diagnostic]) -> bool:
    """Return True if diagnostics of reading a camera state that the camera was scaled."""
    return any(one.code == CAMERA_CALIBRATION_SCALED.name for one in diagnostics)


def is_off_centre(camera: Camera) -> bool:
    """Return True if the principal point is more than a quarter image from the centre.

    The calibration then probably belongs to other images.
    """
    return any(abs(share - 0.5) > _MAX_CENTRE_OFFSET_RATIO for share in _compute_relative_centre(camera))


def fix_transposed_size(camera: Camera, width: int, height: int) -> Camera:
    """Swap width and height of a camera if the file stated rows first (NumPy order).

    The sides are swapped only if that brings the principal point closer to the image centre.

    Parameters
    ----------
    camera : camera with the size as stated.
    width, height : size of the images, pixels.
    """
    if (camera.width, camera.height) != (height, width) or width == height:
        return camera
    turned = replace(camera, width=width, height=height)
    before, after = (
        max(abs(share - 0.5) for share in _compute_relative_centre(one)) for one in (camera, turned)
    )
    return turned if after < before else camera


def _compute_relative_centre(camera: Camera) -> tuple[float, float]:
    """Return the principal point as ratios of image width and height."""
    return (camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height


def _warn_off_centre(camera: Camera, path: Path) -> None:
    if not is_off_centre(camera):
        return
    across, down = _compute_relative_centre(camera)
    hint = ""
    if across > 0 and abs(across / max(down, 1e-9) - 1) < _FACTOR_TOLERANCE:
        larger = (across + down) * camera.width, (across + down) * camera.height
        hint = f", such as {larger[0]:.0f}×{larger[1]:.0f}"
    emit(
        CAMERA_CALIBRATION_MISMATCH.warning(
            "its principal point ({cx:g}, {cy:g}) is far from the centre of images of "
            "{width}×{height} px; it may be for another image size{hint}",
            path,
            remedy="scan.intrinsics=fx,fy,cx,cy overrides it",
            cx=camera.cx,
            cy=camera.cy,
            width=camera.width,
            height=camera.height,
            hint=hint,
        )
    )
