"""Timestamped streams of a scan, independent of recorder and file format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.scans.calibration.camera_resolution import get_stated_camera
from scanloom.stages.scans.codes import SCAN_ASSUMED
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, ColorImage, Pose, StereoRig


@dataclass(frozen=True, eq=False)
class TimestampedImages:
    """Images of one stream, by index.

    The callables raise InputError if the file is damaged.

    Attributes
    ----------
    name : name of the stream, for messages.
    record_times_ns : (n,) int64 nanoseconds at which the recorder wrote the images.
    read_timestamp : return the capture time of an image, nanoseconds on the clock of its camera.
    read_color : return an image as (h, w, 3) uint8 RGB.
    read_depth : return an image as a raw depth map, (h, w) uint16 or float32.
    find_file : return the file that contains an image.
    """

    name: str
    record_times_ns: NDArray[np.int64]
    read_timestamp: Callable[[int], int]
    read_color: Callable[[int], ColorImage]
    read_depth: Callable[[int], NDArray[Any]]
    find_file: Callable[[int], Path]


@dataclass(frozen=True, eq=False)
class Accelerometer:
    """Readings of an accelerometer, by index.

    Attributes
    ----------
    name : name of the sensor, for messages.
    record_times_ns : (n,) int64 nanoseconds at which the recorder wrote the readings.
    read : return a reading (3,) in m/s², in the axes of the sensor. At rest it points up. Raises InputError
        if the file is damaged.
    camera_from_sensor : (3, 3) float64 rotation from the sensor axes to the axes of the frames' camera; None
        if
        the recording does not contain it.
    """

    name: str
    record_times_ns: NDArray[np.int64]
    read: Callable[[int], NDArray[np.float64]]
    camera_from_sensor: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class CameraStream:
    """Images and the camera that captured them."""

    images: TimestampedImages
    camera: Camera


@dataclass(frozen=True, eq=False)
class DepthColorStreams:
    """Depth stream and optional colour stream of a scan.

    Attributes
    ----------
    depth, color : `read_color` may hold infrared images, or be None.
    depth_scale : depth units per metre.
    color_from_depth : (4, 4) float64, metres; None if both cameras coincide or the file does not state it.
    accelerometer : accelerometer of the recording, or None.
    """

    depth: CameraStream
    color: CameraStream | None
    depth_scale: float
    color_from_depth: Pose | None
    accelerometer: Accelerometer | None = None


@dataclass(frozen=True, eq=False)
class StereoStreams:
    """Left and right stream of a stereo recording without depth.

    Attributes
    ----------
    accelerometer : accelerometer of the recording, or None.
    """

    left: TimestampedImages
    right: TimestampedImages
    rig: StereoRig
    accelerometer: Accelerometer | None = None


def get_stated_depth_camera(depth: TimestampedImages, folder: Path, options: ReadingParams) -> Camera | None:
    """Return the depth camera given by the user, or None.

    The camera is sized for the first depth map.

    Raises
    ------
    InputError
        If the calibration file or the first depth map cannot be read.
    """
    if options.intrinsics is None and options.calibration is None:
        return None
    height, width = depth.read_depth(0).shape
    return get_stated_camera(options, folder, width, height)


def create_extrinsics_warning(depth: str, color: str) -> Diagnostic:
    """Create the warning for a recording without extrinsics between its cameras.

    Parameters
    ----------
    depth, color : names of the streams.
    """
    return SCAN_ASSUMED.warning(
        "the recording does not contain the extrinsics between {color} and {depth}: the cameras "
        "are assumed to coincide, so colours may be displaced",
        color=color,
        depth=depth,
    )
