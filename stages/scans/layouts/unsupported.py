"""Layouts that are recognised but not supported, to give a specific error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_RGBD = "Export the recording as color/, depth/ and scan.json (scanloom's own RGB-D layout)."
_PACKED = "Decompress its files with `zstd --decompress`; metadata.yaml needs no change."
_CONTAINER = "Extract images with the manufacturer's tool into left/ and right/, or into color/ and depth/."


@dataclass(frozen=True)
class Refused:
    """Unsupported layout.

    Attributes
    ----------
    name : name of the data set or program.
    files : glob patterns; a folder matches if each pattern matches a file.
    advice : remedy for the user.
    """

    name: str
    files: tuple[str, ...]
    advice: str = _RGBD


REFUSED: tuple[Refused, ...] = (
    Refused("a compressed ROS 2 recording (.db3.zstd)", ("*.db3.zstd",), _PACKED),
    Refused("a compressed ROS 2 recording (.mcap.zstd)", ("*.mcap.zstd",), _PACKED),
    Refused("an Azure Kinect recording (.mkv)", ("*.mkv",), _CONTAINER),
    Refused("a ZED recording (.svo)", ("*.svo*",), _CONTAINER),
)


def refused(place: Path) -> Refused | None:
    """Return the unsupported layout that a folder or file has, or None."""
    if place.is_file():
        return next((one for one in REFUSED if all(place.match(files) for files in one.files)), None)
    return next((one for one in REFUSED if all(any(place.glob(files)) for files in one.files)), None)
