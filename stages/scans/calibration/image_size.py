"""The size of images that a calibration states, and its camera for those that are there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.calibration.table_values import number_of, number_row
from scanloom.stages.scans.codes import (
    CAMERA_CALIBRATION_INVALID,
    CAMERA_CALIBRATION_MISMATCH,
    CAMERA_CALIBRATION_SCALED,
)
from scanloom.stages.scans.model.scan import Camera, scaled

# Two numbers, or a name for each.
_SIZES = ("image_size", "imageSize", "img_size", "resolution", "size")
_SIDES = (("width", "height"), ("image_width", "image_height"), ("image_Width", "image_Height"), ("w", "h"))
LARGEST_SIDE = 1 << 16
# Sides are rounded where images are made smaller: 1280×720 becomes 854×480.
_SAME_SHAPE = 0.01
# A lens is not mounted so far from the middle of its images, as a share of them.
_OFF_CENTRE = 0.25
# Where the centre says another size, both of its numbers say the same one.
_SAME_FACTOR = 0.1


def stated_size(values: dict[str, Any], width: int, height: int, path: Path) -> tuple[int, int]:
    """Return the (width, height) in pixels that a table states; that of the images where it says nothing.

    Raises
    ------
    InputError
        If what it states can be no size.
    """
    sides = next((names for names in _SIDES if all(name in values for name in names)), None)
    pair = next((name for name in _SIZES if name in values), None)
    if sides is not None:
        size = tuple(number_of(values[name], name, path) for name in sides)
    elif pair is not None and not isinstance(values[pair], (int, float, str)):
        size = number_row(values[pair], pair, path)
    else:
        return width, height
    if len(size) != 2 or not all(1 <= side <= LARGEST_SIDE for side in size):
        shown = "×".join(f"{side:g}" for side in size[:4])
        raise InputError(
            CAMERA_CALIBRATION_INVALID,
            "the size of its images, {shown}, cannot be right.",
            path,
            shown=shown,
        )
    return round(size[0]), round(size[1])


def for_images(camera: Camera, width: int, height: int, path: Path) -> Camera:
    """Return the camera of a calibration for images of this size, which are the same ones made smaller.

    Warns if the camera is scaled, and if its principal point is far from the centre of the images.

    Raises
    ------
    InputError
        If the size that the calibration is for has another shape: images are then cropped or turned.
    """
    if (camera.width, camera.height) == (width, height):
        _check_centre(camera, path)
        return camera
    if not is_of_shape((camera.width, camera.height), (width, height)):
        raise InputError(
            CAMERA_CALIBRATION_MISMATCH,
            (
                "it is for images of {camera_width}×{camera_height}, but these are "
                "{width}×{height}, which is another shape: they are cropped or turned."
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
            "it is for images of {camera_width}×{camera_height}: its camera is scaled to these of "
            "{width}×{height}",
            path,
            camera_width=camera.width,
            camera_height=camera.height,
            width=width,
            height=height,
        )
    )
    return scaled(camera, width, height)


def is_of_shape(first: tuple[int, int], second: tuple[int, int]) -> bool:
    """Say whether two sizes, (width, height), are those of one image made smaller.

    Where one side is the same and the other is not, the image was cropped.
    """
    if (first[0] == second[0]) != (first[1] == second[1]):
        return False
    return abs(first[0] * second[1] / (first[1] * second[0]) - 1) <= _SAME_SHAPE


def was_scaled(diagnostics: Sequence[Diagnostic]) -> bool:
    """Say whether a camera was for another size, by what was emitted while it was read."""
    return any(one.code == CAMERA_CALIBRATION_SCALED.name for one in diagnostics)


def is_off_centre(camera: Camera) -> bool:
    """Say whether the principal point is far from the middle of the images: they are probably others."""
    return any(abs(share - 0.5) > _OFF_CENTRE for share in _centre(camera))


def with_rows_first(camera: Camera, width: int, height: int) -> Camera:
    """Return a camera for images whose size was written rows first, as NumPy has it, if its centre says so.

    Parameters
    ----------
    camera : as if columns had been first.
    width, height : of the images, in pixels.
    """
    if (camera.width, camera.height) != (height, width) or width == height:
        return camera
    turned = replace(camera, width=width, height=height)
    before, after = (max(abs(share - 0.5) for share in _centre(one)) for one in (camera, turned))
    return turned if after < before else camera


def _centre(camera: Camera) -> tuple[float, float]:
    """Return where the principal point is, as shares of the images."""
    return (camera.cx + 0.5) / camera.width, (camera.cy + 0.5) / camera.height


def _check_centre(camera: Camera, path: Path) -> None:
    if not is_off_centre(camera):
        return
    across, down = _centre(camera)
    hint = ""
    if across > 0 and abs(across / max(down, 1e-9) - 1) < _SAME_FACTOR:
        larger = (across + down) * camera.width, (across + down) * camera.height
        hint = f", such as {larger[0]:.0f}×{larger[1]:.0f}"
    emit(
        CAMERA_CALIBRATION_MISMATCH.warning(
            "it has its principal point at ({cx:g}, {cy:g}), far from the centre of images of "
            "{width}×{height}: it may be for another size{hint}",
            path,
            remedy="scan.intrinsics=fx,fy,cx,cy states the right one",
            cx=camera.cx,
            cy=camera.cy,
            width=camera.width,
            height=camera.height,
            hint=hint,
        )
    )
