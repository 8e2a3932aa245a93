"""Timestamped streams of a scan, independent of recorder and file format."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.scans.calibration.resolution import stated_camera
from scanloom.stages.scans.codes import SCAN_ASSUMED
from scanloom.stages.scans.model.reading_params import ReadingParams
from scanloom.stages.scans.model.scan import Camera, ColorImage, Pose, StereoRig


@dataclass(frozen=True, eq=False)
class Images:
    """Images of one stream, by index.

    The callables raise InputError if the file is damaged.

    Attributes
    ----------
    name : name of the stream, for messages.
    recorded : (n,) int64 nanoseconds at which the recorder wrote the images.
    stamp : return the capture time of an image, nanoseconds on the clock of its camera.
    color : return an image as (h, w, 3) uint8 RGB.
    depth : return an image as a raw depth map, (h, w) uint16 or float32.
    file : return the file that contains an image.
    """

    name: str
    recorded: NDArray[np.int64]
    stamp: Callable[[int], int]
    color: Callable[[int], ColorImage]
    depth: Callable[[int], NDArray[Any]]
    file: Callable[[int], Path]


@dataclass(frozen=True, eq=False)
class Accelerometer:
    """Readings of an accelerometer, by index.

    Attributes
    ----------
    name : name of the sensor, for messages.
    recorded : (n,) int64 nanoseconds at which the recorder wrote the readings.
    read : return a reading (3,) in m/s², in the axes of the sensor. At rest it points up. Raises InputError
        if the file is damaged.
    camera_from_it : (3, 3) float64 rotation from the sensor axes to the axes of the frames' camera; None if
        the recording does not contain it.
    """

    name: str
    recorded: NDArray[np.int64]
    read: Callable[[int], NDArray[np.float64]]
    camera_from_it: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class Stream:
    """Images and the camera that captured them."""

    images: Images
    camera: Camera


@dataclass(frozen=True, eq=False)
class Streams:
    """Depth stream and optional colour stream of a scan.

    Attributes
    ----------
    depth, color : `color` may hold infrared images, or be None.
    depth_scale : depth units per metre.
    color_from_depth : (4, 4) float64, metres; None if both cameras coincide or the file does not state it.
    accelerometer : accelerometer of the recording, or None.
    """

    depth: Stream
    color: Stream | None
    depth_scale: float
    color_from_depth: Pose | None
    accelerometer: Accelerometer | None = None


@dataclass(frozen=True, eq=False)
class Pair:
    """Left and right stream of a stereo recording without depth.

    Attributes
    ----------
    accelerometer : accelerometer of the recording, or None.
    """

    left: Images
    right: Images
    rig: StereoRig
    accelerometer: Accelerometer | None = None


def stated_depth_camera(depth: Images, folder: Path, options: ReadingParams) -> Camera | None:
    """Return the depth camera given by the user, or None.

    The camera is sized for the first depth map.

    Raises
    ------
    InputError
        If the calibration file or the first depth map cannot be read.
    """
    if options.intrinsics is None and options.calibration is None:
        return None
    height, width = depth.depth(0).shape
    return stated_camera(options, folder, width, height)


def extrinsics_unknown(depth: str, color: str) -> Diagnostic:
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
