"""The undistorted images of views."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_pinhole
from scanloom.stages.scans.model.scan import ColorImage, Frame
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
