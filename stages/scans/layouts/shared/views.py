"""Posed views without depth: what of a folder becomes a frame, and in which layouts it cannot yet."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.images import image_size
from scanloom.stages.scans.codes import CAMERA_CALIBRATION_MISMATCH, SCAN_DEPTH_MISSING
from scanloom.stages.scans.layouts.shared.phones import seen_in
from scanloom.stages.scans.model.depth_range import range_of_points
from scanloom.stages.scans.model.scan import Camera, Frame, Packed, Pose

# Two widths that differ by less are nearly one.
_NEARLY = 0.1


def single_view(
    name: str,
    camera: Camera,
    color: Path,
    pose: Pose | None,
    *,
    points: NDArray[np.float64] | None = None,
    mask: Path | Packed | None = None,
) -> Frame:
    """Return the frame of a view without depth.

    Parameters
    ----------
    camera : of the image in any size: images are often made smaller after their cameras were found.
    pose : world-from-camera, metres.
    points : (n, 3) metres, world, that a reconstruction found in the view.
    mask : as of a Frame.

    Raises
    ------
    InputError
        If the image is missing or damaged, or not of the shape of its camera.
    """
    size = image_size(color)
    if size != (camera.width, camera.height):
        _check_nearly(camera, size, color)
        camera = seen_in(camera, size, "the image", color)
    depth_range = None
    if points is not None and pose is not None:
        depth_range = range_of_points((points - pose[:3, 3]) @ pose[:3, 2])
    return Frame(name, camera, color=color, world_from_camera=pose, mask=mask, depth_range=depth_range)


def _check_nearly(camera: Camera, size: tuple[int, int], color: Path) -> None:
    """Warn if an image has nearly its camera's size: nobody makes images so little smaller."""
    if abs(size[0] / camera.width - 1) < _NEARLY:
        emit(
            CAMERA_CALIBRATION_MISMATCH.warning(
                "it is {width}×{height} and its camera {camera_width}×{camera_height}: such cameras are of "
                "images whose lens was straightened, which this may not be; it is scaled",
                color,
                width=size[0],
                height=size[1],
                camera_width=camera.width,
                camera_height=camera.height,
            )
        )


def in_metres(pose: Pose | None, units: float | None) -> Pose | None:
    """Return a pose in metres, of one in a world of so many `units` a metre (1 if not known)."""
    if pose is None or units is None:
        return pose
    metric: Pose = pose.copy()
    metric[:3, 3] /= units
    return metric


def without_depth(place: Path, advice: str) -> InputError:
    """Return the error for a folder (or its list of frames) whose posed views have no depth maps.

    Parameters
    ----------
    place : what the message names.
    advice : a sentence: where this layout would keep its depth.
    """
    return InputError(
        SCAN_DEPTH_MISSING,
        "its views have no depth, and views of this layout alone cannot be read yet. {advice}",
        place,
        advice=advice,
    )
