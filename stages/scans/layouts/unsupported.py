"""Layouts that are recognised but not supported, to give a specific error."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.input_files import open_input

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
    marker : bytes near the beginning of the first matching file, where the name alone is ambiguous.
    """

    name: str
    patterns: tuple[str, ...]
    advice: str = _EXPORT_ADVICE
    marker: bytes = b""


UNSUPPORTED_LAYOUTS: tuple[UnsupportedLayout, ...] = (
    UnsupportedLayout("a compressed ROS 2 recording (.db3.zstd)", ("*.db3.zstd",), _DECOMPRESS_ADVICE),
    UnsupportedLayout("a compressed ROS 2 recording (.mcap.zstd)", ("*.mcap.zstd",), _DECOMPRESS_ADVICE),
    # Other .mkv files are videos. Tags such as K4A_COLOR_MODE precede the images.
    UnsupportedLayout("an Azure Kinect recording (.mkv)", ("*.mkv",), _EXTRACT_ADVICE, b"K4A_"),
    UnsupportedLayout("a ZED recording (.svo)", ("*.svo*",), _EXTRACT_ADVICE),
)


# Bytes that are searched for a marker: headers, tags and attachments of a recording.
_SEARCHED_BYTES = 1 << 20


def find_unsupported_layout(place: Path) -> UnsupportedLayout | None:
    """Return the unsupported layout that a folder or file has, or None."""
    return next((one for one in UNSUPPORTED_LAYOUTS if _has_layout(place, one)), None)


def _has_layout(place: Path, layout: UnsupportedLayout) -> bool:
    if place.is_file():
        file = place if all(place.match(pattern) for pattern in layout.patterns) else None
    else:
        firsts = [min(place.glob(pattern), default=None) for pattern in layout.patterns]
        file = None if None in firsts else firsts[0]
    return file is not None and (not layout.marker or _contains(file, layout.marker))


def _contains(file: Path, marker: bytes) -> bool:
    try:
        with open_input(file) as stream:
            return marker in stream.read(_SEARCHED_BYTES)
    except InputError:
        return False
