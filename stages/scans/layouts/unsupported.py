"""Layouts that are recognised but not supported, to give a specific error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

_EXPORT_ADVICE = "Export the recording as color/, depth/ and scan.json (scanloom's own RGB-D layout)."
_DECOMPRESS_ADVICE = "Decompress its files with `zstd --decompress`; metadata.yaml needs no change."
_EXTRACT_ADVICE = (
    "Extract images with the manufacturer's tool into left/ and right/, or into color/ and depth/."
)


@dataclass(frozen=True)
class UnsupportedLayout:
    """Unsupported layout.

    Attributes
    ----------
    name : name of the data set or program.
    patterns : glob patterns; a folder matches if each pattern matches a file.
    advice : remedy for the user.
    """

    name: str
    patterns: tuple[str, ...]
    advice: str = _EXPORT_ADVICE


UNSUPPORTED_LAYOUTS: tuple[UnsupportedLayout, ...] = (
    UnsupportedLayout("a compressed ROS 2 recording (.db3.zstd)", ("*.db3.zstd",), _DECOMPRESS_ADVICE),
    UnsupportedLayout("a compressed ROS 2 recording (.mcap.zstd)", ("*.mcap.zstd",), _DECOMPRESS_ADVICE),
    UnsupportedLayout("an Azure Kinect recording (.mkv)", ("*.mkv",), _EXTRACT_ADVICE),
    UnsupportedLayout("a ZED recording (.svo)", ("*.svo*",), _EXTRACT_ADVICE),
)


def find_unsupported_layout(place: Path) -> UnsupportedLayout | None:
    """Return the unsupported layout that a folder or file has, or None."""
    if place.is_file():
        return next(
            (one for one in UNSUPPORTED_LAYOUTS if all(place.match(files) for files in one.patterns)), None
        )
    return next(
        (one for one in UNSUPPORTED_LAYOUTS if all(any(place.glob(files)) for files in one.patterns)), None
    )
