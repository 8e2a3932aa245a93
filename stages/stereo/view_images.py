"""Images of single views, undistorted or downscaled."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_pinhole, require_size
from scanloom.stages.scans.model.scan import ColorImage, Frame, PackedImage, scale_camera
from scanloom.stages.stereo.posed_views import PosedView


@dataclass(frozen=True, eq=False)
class ViewImage:
    """View with its image.

    Attributes
    ----------
    view : posed view.
    grey : (h, w) uint8.
    object_mask : (h, w), pixels that may show the object that masks cut out of all views; None without such
        masks.
    """

    view: PosedView
    grey: NDArray[np.uint8]
    object_mask: NDArray[np.bool_] | None = None


def read_view_color(frame: Frame) -> ColorImage:
    """Read the undistorted image of a frame, (h, w, 3) uint8.

    Raises
    ------
    InputError
        If the image is missing or cannot be read.
    """
    color = read_pinhole(frame)
    if color is None:
        raise InputError(FRAME_IMAGE_MISSING, "the image is missing.", DiagnosticLocation(frame=frame.name))
    return color


def convert_to_grey(color: ColorImage) -> NDArray[np.uint8]:
    """Convert an RGB image to grey, (h, w) uint8."""
    import cv2

    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)


def downscale(frame: Frame, max_side: int) -> Frame:
    """Downscale the image and the camera of a single view.

    A frame whose image is small enough is returned unchanged. An image in a file is read and downscaled on
    each access.

    Parameters
    ----------
    max_side : maximum width and height, pixels.
    """
    camera = frame.camera
    factor = max_side / max(camera.width, camera.height)
    if factor >= 1 or frame.color is None:
        return frame
    size = max(round(camera.width * factor), 1), max(round(camera.height * factor), 1)

    def load() -> ColorImage:
        import cv2

        color = read_color(frame)
        if color is None:
            raise InputError(
                FRAME_IMAGE_MISSING, "the image is missing.", DiagnosticLocation(frame=frame.name)
            )
        require_size(color, camera, frame.color, frame.name)
        return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)

    if isinstance(frame.color, np.ndarray):
        color: PackedImage | ColorImage = load()
    else:
        file = frame.color if isinstance(frame.color, Path) else frame.color.file
        color = PackedImage(file, f"{frame.name}, smaller", load)
    return replace(frame, camera=scale_camera(camera, *size), color=color)
