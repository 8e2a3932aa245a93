"""The two streams of a recording that make up a scan, whoever recorded it, and in whatever kind of file."""

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
    """The images of a topic, by their number; all that reads raises InputError where the file is damaged.

    Attributes
    ----------
    name : of the stream, for messages.
    recorded : (n,) int64 nanoseconds at which the recorder wrote them.
    stamp : returns when an image was taken, nanoseconds by its camera's clock.
    color : returns an image as (h, w, 3) uint8 RGB.
    depth : returns an image as a raw depth map, (h, w) uint16 or float32.
    file : returns which file an image is in.
    """

    name: str
    recorded: NDArray[np.int64]
    stamp: Callable[[int], int]
    color: Callable[[int], ColorImage]
    depth: Callable[[int], NDArray[Any]]
    file: Callable[[int], Path]


@dataclass(frozen=True, eq=False)
class Accelerometer:
    """The readings of an accelerometer, by their number.

    Attributes
    ----------
    name : for messages.
    recorded : (n,) int64 nanoseconds at which the recorder wrote them.
    read : returns a reading (3,), m/s², in its own axes: at rest it points up; raises InputError where the
        file is damaged.
    camera_from_it : (3, 3) float64, turns its axes to those of the camera whose images are frames; None where
        the recording does not say.
    """

    name: str
    recorded: NDArray[np.int64]
    read: Callable[[int], NDArray[np.float64]]
    camera_from_it: NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class Stream:
    """Images and the camera that took them."""

    images: Images
    camera: Camera


@dataclass(frozen=True, eq=False)
class Streams:
    """The streams of a recording that make up a scan.

    Attributes
    ----------
    depth, color : colour may show what an infrared camera saw, or be None.
    depth_scale : what one metre is in the depth maps' units.
    color_from_depth : (4, 4) float64, metres; None where both stand in one place or the file does not say.
    accelerometer : beside them, if there is one.
    """

    depth: Stream
    color: Stream | None
    depth_scale: float
    color_from_depth: Pose | None
    accelerometer: Accelerometer | None = None


@dataclass(frozen=True, eq=False)
class Pair:
    """The two streams of a recording that make up a scan without depth.

    Attributes
    ----------
    accelerometer : beside them, if there is one.
    """

    left: Images
    right: Images
    rig: StereoRig
    accelerometer: Accelerometer | None = None


def stated_depth_camera(depth: Images, folder: Path, options: ReadingParams) -> Camera | None:
    """Return the depth camera that the person states, for the size of the first depth map; None if not."""
    if options.intrinsics is None and options.calibration is None:
        return None
    height, width = depth.depth(0).shape
    return stated_camera(options, folder, width, height)


def extrinsics_unknown(depth: str, color: str) -> Diagnostic:
    """Return the warning for cameras that nothing in the recording relates."""
    return SCAN_ASSUMED.warning(
        "how the camera of {color} stands to that of {depth} is not in the file: both are taken to stand in "
        "one place, so that colours may be displaced",
        color=color,
        depth=depth,
    )
