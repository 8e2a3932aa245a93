"""Images made smaller: photographs of many megapixels take long to match, and a mesh needs fewer."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.scans.codes import FRAME_IMAGE_MISSING
from scanloom.stages.scans.model.images import read_color, require_size
from scanloom.stages.scans.model.scan import ColorImage, Frame, Packed, scaled


def reduced(frame: Frame, longest: int) -> Frame:
    """Return a single view whose image is at most `longest` pixels wide and high; the frame itself if it is.

    The camera is scaled with the image, which is read and made smaller each time if it is a file.
    """
    camera = frame.camera
    factor = longest / max(camera.width, camera.height)
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
