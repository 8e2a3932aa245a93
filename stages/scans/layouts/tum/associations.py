"""associations.txt: matched colour and depth images, `time file time file` per line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files import documents
from scanloom.stages.scans.codes import SCAN_FILES_MISSING, SCAN_TABLE_DAMAGED
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories


@dataclass(frozen=True)
class Association:
    """Matched colour and depth image with their timestamps in nanoseconds."""

    color_time: int
    color: Path
    depth_time: int
    depth: Path


def read_associations(path: Path) -> list[Association]:
    """Read the matched colour and depth images of a list.

    The depth file of a line is the one in a depth folder; the order of both files may vary.

    Raises
    ------
    InputError
        If a line is malformed, names two files of one kind or a file outside the folder, or the list is
        empty.
    """
    found = []
    for number, text in documents.iterate_lines(path):
        words = text.split()
        if len(words) != 4:
            raise InputError(
                SCAN_TABLE_DAMAGED, "line {number} is not `time file time file`.", path, number=number
            )
        is_depth = [any("depth" in part for part in Path(word).parts[:-1]) for word in (words[1], words[3])]
        if is_depth[0] == is_depth[1]:
            raise InputError(
                SCAN_FILES_MISSING,
                "line {number} must name one file in depth/ and one in another folder, such as rgb/.",
                path,
                number=number,
            )
        at, other = (0, 2) if is_depth[0] else (2, 0)
        depth, color = (
            path.parent / documents.require_inside(words[place + 1], path, f"line {number}")
            for place in (at, other)
        )
        depth_time, color_time = (
            trajectories.parse_timestamp(words[place], path, number) for place in (at, other)
        )
        found.append(Association(color_time, color, depth_time, depth))
    if not found:
        raise InputError(SCAN_TABLE_DAMAGED, "the file lists no images.", path)
    return found
