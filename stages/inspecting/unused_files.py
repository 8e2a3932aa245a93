"""Detection of unused files in a scan folder.

Nothing is ignored silently: each file is reported with a guess at its content.
"""

from __future__ import annotations

import os
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice, takewhile
from pathlib import Path

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.file_access_log import pause_recording
from scanloom.stages.printing import format_by_fields
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.image_folders.image_files import DEPTH_SUFFIXES, IMAGE_SUFFIXES
from scanloom.stages.scans.layouts.tum.associations import read_associations
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.trajectory import trajectory_formats as trajectories
from scanloom.stages.scans.transforms.adjusted_cameras import apply_adjusted_cameras
from scanloom.stages.scans.transforms.depth_calibration import apply_depth_calibration

# Maximum number of files examined in a folder.
_MAX_FILES = 20_000
# Up to this number, files of one type in a folder are listed individually; more are summarised in one entry.
_MAX_LISTED = 3
_MAX_LISTED_TEXTS = 12
# Bytes. Larger text files are logs or meshes; a pose takes about a hundred bytes.
_MAX_BYTES = 1 << 22
_TEXT_SUFFIXES = (
    ".json",
    ".yaml",
    ".yml",
    ".toml",
    ".xml",
    ".txt",
    ".csv",
    ".log",
    ".tum",
    ".traj",
    ".freiburg",
    ".npz",
    ".conf",
)
_CONTENT_BY_SUFFIX = {
    ".ply": "points or a mesh",
    ".obj": "a mesh",
    ".glb": "a mesh",
    ".bag": "a recording: a separate scan",
    ".db3": "a recording: a separate scan",
    ".mcap": "a recording: a separate scan",
    ".sens": "a recording: a separate scan",
    ".r3d": "a recording: a separate scan",
    ".mp4": "a video",
    ".mov": "a video",
}
# Prefixes of files for people or operating systems, which are not reported.
_IGNORED_PREFIXES = ("readme", "license", "licence", "thumbs.db", "desktop.ini")


@dataclass(frozen=True)
class UnusedFile:
    """Unused file, or group of unused files in one folder.

    Attributes
    ----------
    name : path relative to the scan folder; a pattern for a group.
    count : number of files.
    looks_like : guessed content and the option that reads it; empty if unknown.
    """

    name: str
    count: int
    looks_like: str

    __repr__ = format_by_fields

    def __str__(self) -> str:
        """Describe the entry for people."""
        several = f" ({self.count} files)" if self.count > 1 else ""
        return f"{self.name}{several}" + (f" looks like {self.looks_like}" if self.looks_like else "")


def find_unused_files(scan: Scan) -> tuple[UnusedFile, ...]:
    """List the files below a scan's folder that were not read."""
    if scan.folder is None or not scan.folder.is_dir() or not scan.source_files:
        return ()
    known = {os.path.realpath(path) for path in scan.source_files}
    files = []
    for path in islice(_iterate_files(scan.folder), _MAX_FILES):
        # Links can lead to the same file twice, or to a folder that contains itself.
        if (real := os.path.realpath(path)) not in known:
            known.add(real)
            files.append(path)
    stems_by_type: dict[tuple[Path, str], list[str]] = defaultdict(list)
    for path in files:
        stems_by_type[path.parent, path.suffix.lower()].append(path.stem)
    # Warnings from trial reads are not about the scan.
    with pause_recording(), collecting(forward=False):
        found = [
            UnusedFile(path.relative_to(scan.folder).as_posix(), 1, _guess_content(path, scan))
            for path in files
            if len(stems_by_type[path.parent, path.suffix.lower()]) <= _get_listing_limit(path.suffix.lower())
        ]
    groups = [
        UnusedFile(
            (place / f"{_find_common_prefix(stems)}*{suffix}").relative_to(scan.folder).as_posix(),
            len(stems),
            _guess_group_content(place, suffix),
        )
        for (place, suffix), stems in stems_by_type.items()
        if len(stems) > _get_listing_limit(suffix)
    ]
    return tuple(sorted([*found, *groups], key=lambda one: (not one.looks_like, one.name)))


def _iterate_files(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder; linked folders are visited once."""
    seen = {os.path.realpath(folder)}
    waiting = [folder]
    while waiting:
        place = waiting.pop(0)
        for path in _list_folder(place):
            if path.is_file():
                yield path
            elif path.is_dir() and (real := os.path.realpath(path)) not in seen:
                seen.add(real)
                waiting.append(path)


def _list_folder(folder: Path) -> list[Path]:
    try:
        found = sorted(folder.iterdir())
    except OSError:
        return []
    return [one for one in found if one.name[0] != "." and not one.name.lower().startswith(_IGNORED_PREFIXES)]


def _find_common_prefix(stems: Sequence[str]) -> str:
    """Return the common prefix of file names, without trailing digits."""
    # The common prefix of the first and last name in sorted order is shared by all names.
    both = takewhile(lambda pair: pair[0] == pair[1], zip(min(stems), max(stems), strict=False))
    return "".join(one for one, _ in both).rstrip("0123456789")


def _get_listing_limit(suffix: str) -> int:
    return _MAX_LISTED_TEXTS if suffix in _TEXT_SUFFIXES else _MAX_LISTED


def _guess_group_content(folder: Path, suffix: str) -> str:
    if suffix in IMAGE_SUFFIXES and "mask" in folder.name.lower():
        return f"masks: scan.masks={folder.name}"
    if suffix in IMAGE_SUFFIXES and "conf" in folder.name.lower():
        return "confidence maps"
    if suffix in DEPTH_SUFFIXES and folder.name.lower().startswith("disp"):
        return "ground-truth disparities"
    return "images" if suffix in IMAGE_SUFFIXES else _CONTENT_BY_SUFFIX.get(suffix, "")


def _guess_content(path: Path, scan: Scan) -> str:
    """Guess the content of a file, and the option that reads it."""
    suffix = path.suffix.lower()
    if path.stem.lower().startswith("disp") and suffix in DEPTH_SUFFIXES:
        return "ground-truth disparities"
    if suffix in IMAGE_SUFFIXES:
        return "an image"
    if suffix not in _TEXT_SUFFIXES or path.stat().st_size > _MAX_BYTES:
        return _CONTENT_BY_SUFFIX.get(suffix, "")
    if (count := _count_poses(path)) > 1:
        return f"{count} poses: scan.poses={path.name}"
    if path.suffix == ".txt" and _is_readable(lambda: read_associations(path)):
        return "pairs of colour and depth images, which this layout does not need"
    if _is_readable(lambda: apply_adjusted_cameras(scan, path)):
        return f"a result of adjust: scan.adjusted_cameras={path.name}"
    if _is_readable(lambda: apply_depth_calibration(scan, path)):
        return f"a depth calibration: scan.depth_calibration={path.name}"
    camera = scan.frames[0].camera
    size = camera.width, camera.height
    if scan.is_stereo and _is_readable(lambda: rig_calibration.read_rig(path, *size)):
        return f"a stereo calibration: scan.calibration={path.name}"
    if not _is_readable(lambda: calibration.read_camera(path, *size)):
        return ""
    return (
        "the calibration of a single camera"
        if scan.is_stereo
        else f"a camera calibration: scan.calibration={path.name}"
    )


def _is_readable(read: Callable[[], object]) -> bool:
    try:
        read()
    except InputError:
        return False
    return True


def _count_poses(path: Path) -> int:
    try:
        return len(trajectories.read_trajectory(path))
    except InputError:
        return 0
