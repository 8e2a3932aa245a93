"""The camera that the person states in place of the folder's."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stages.formats import calibration
from stages.scan import Camera

if TYPE_CHECKING:
    from stages.layouts.params import ScanParams


def stated_camera(options: ScanParams, folder: Path, width: int, height: int) -> Camera | None:
    """Return the camera that the person states for images of this size, in numbers or as a file, or None."""
    path = options.file("calibration", folder)
    stated = options.camera(width, height)
    return calibration.read_camera(path, width, height) if stated is None and path is not None else stated
