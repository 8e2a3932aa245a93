"""Images of views, undistorted or downscaled."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, read_pinhole, require_size
from scanloom.stages.scans.model.scan import ColorImage, Frame, Packed, scaled
from scanloom.stages.stereo.posed_views import PosedView


@dataclass(frozen=True, eq=False)
class Seen:
    """A view and its image.

    Attributes
    ----------
    grey : (h, w) uint8.
    thing : (h, w), where the thing is that masks cut out of all views; what lies elsewhere is no part of it.
    """

    view: PosedView
    grey: NDArray[np.uint8]
    thing: NDArray[np.bool_] | None = None


def color_of(frame: Frame) -> ColorImage:
    """Return the image of a frame, (h, w, 3) uint8.

    Raises
    ------
    InputError
        If there is none, or it cannot be read.
    """
    color = read_pinhole(frame)
    if color is None:
        raise InputError(FRAME_IMAGE_MISSING, "there is no image.", Where(frame=frame.name))
    return color


def grey_of(color: ColorImage) -> NDArray[np.uint8]:
    """Return the brightness of an image, (h, w) uint8."""
    import cv2

    return np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2GRAY), np.uint8)


def downscale(frame: Frame, max_side: int) -> Frame:
    """Downscale the image and camera of a single view to at most `max_side` pixels wide and high.

    A frame whose image is small enough is returned as it is. An image in a file is read and downscaled each
    time it is asked for.
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
            raise InputError(FRAME_IMAGE_MISSING, "there is no image.", Where(frame=frame.name))
        require_size(color, camera, frame.color, frame.name)
        return np.asarray(cv2.resize(color, size, interpolation=cv2.INTER_AREA), np.uint8)

    if isinstance(frame.color, np.ndarray):
        color: Packed | ColorImage = load()
    else:
        file = frame.color if isinstance(frame.color, Path) else frame.color.file
        color = Packed(file, f"{frame.name}, smaller", load)
    return replace(frame, camera=scaled(camera, *size), color=color)
