"""The camera of a folder that holds none: what the person states, or a guess that is told.

One rule for every layout. A folder of loose files whose camera file is missing gets the guess below, with a
warning that names the options. Pairs get none, since focal length times baseline is the scale of all they
show: the calibration is asked for. A file that holds its frames and their camera in one (scan.json, .sens,
transforms.json, Record3D's metadata.json) is damaged without it, and refused.
"""

from __future__ import annotations

from pathlib import Path

from stages.files.noting import note
from stages.files.telling import in_sentences
from stages.scans.formats import calibration
from stages.scans.reading.beside import cameras_beside, not_taken
from stages.scans.reading.params import ReadingParams
from stages.scans.scan import Camera

# A PrimeSense or Kinect sees 62.7 degrees across; it is what Open3D falls back to, and near to a RealSense's.
_FOCAL_LENGTH = 525 / 640
# Depth maps of sizes that one kind of device has, and its focal length, px; a phone is held either way.
_OF_SIZE = {
    (192, 256): (187, "a phone's LiDAR"),
    (256, 192): (187, "a phone's LiDAR"),
    (512, 424): (365, "a Kinect v2"),
    (640, 576): (504, "an Azure Kinect, narrow"),
    (320, 288): (252, "an Azure Kinect, narrow"),
}


def stated_camera(options: ReadingParams, folder: Path, width: int, height: int) -> Camera | None:
    """Return the camera that the person states for images of this size, in numbers or as a file, or None."""
    path = options.file("calibration", folder)
    stated = options.camera(width, height)
    return calibration.read_camera(path, width, height) if stated is None and path is not None else stated


def found_camera(folder: Path, width: int, height: int) -> tuple[Camera, Path | None, list[str]]:
    """Return the camera for depth maps of this size that a file beside the images states, and that file.

    Without one the camera is a guess. The last of the three is what is to be said.
    """
    found = cameras_beside(folder, width, height)
    if len({camera for camera, *_ in found}) == 1:
        camera, path, told = found[0]
        note(path)
        name = path.relative_to(folder).as_posix()
        said = f"the camera is read from {name}, which lies beside the images"
        return camera, path, [said, *in_sentences(told)]
    if found:
        names = ", ".join(path.name for _, path, _ in found[:5])
        camera, guessed = _guessed_camera(width, height)
        return camera, None, [f"{names} state different cameras: none is taken", guessed]
    camera, guessed = _guessed_camera(width, height)
    return camera, None, [*not_taken(folder, width, height, calibration.read_camera), guessed]


def _guessed_camera(width: int, height: int) -> tuple[Camera, str]:
    """Return the camera to take for depth maps of this size when nothing is known, and what is to be said."""
    focal, device = _OF_SIZE.get((width, height), (width * _FOCAL_LENGTH, None))
    whose = "a Kinect's view" if device is None else f"that of {device}"
    camera = Camera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2, is_guess=True)
    return camera, (
        f"the folder has no intrinsics: {camera.fx:g},{camera.fy:g},{camera.cx:g},{camera.cy:g} is guessed, "
        f"{whose}; for another camera set scan.intrinsics=fx,fy,cx,cy, or name its file with "
        "scan.calibration=FILE"
    )
