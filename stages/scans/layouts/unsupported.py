"""Layouts that are known by their files but cannot be read yet, so that the person is told what they have."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_RGBD = "Export it as color/, depth/ and scan.json (our plain RGB-D layout)."
_PACKED = "Unpack its files with `zstd --decompress`; its metadata.yaml may stay as it is."
_CONTAINER = "Extract it with the maker's tool into left/ and right/, or into color/ and depth/."


@dataclass(frozen=True)
class Refused:
    """A layout that is recognised and refused by name.

    Attributes
    ----------
    name : of the data set or the program.
    files : patterns; a folder in which each finds something is of this layout.
    advice : what the person can do.
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
    """Return the layout that a folder (or a file) is of but that cannot be read yet, or None."""
    if place.is_file():
        return next((one for one in REFUSED if all(place.match(files) for files in one.files)), None)
    return next((one for one in REFUSED if all(any(place.glob(files)) for files in one.files)), None)
