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
from scanloom.stages.files.noting import only_looking
from scanloom.stages.printing import by_fields
from scanloom.stages.scans.calibration import camera_files as calibration
from scanloom.stages.scans.calibration import rig_calibration
from scanloom.stages.scans.image_folders.image_files import DEPTHS, IMAGES
from scanloom.stages.scans.layouts.tum.associations import read_associations
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.trajectory import files as trajectories
from scanloom.stages.scans.transforms.adjusted_cameras import with_adjusted

# Maximum number of files examined in a folder.
_MOST_FILES = 20_000
# Up to this number, files of one type in a folder are listed individually; more are summarised in one entry.
_ALONE = 3
_TEXTS_ALONE = 12
# Bytes. Larger text files are logs or meshes; a pose takes about a hundred bytes.
_MAX_BYTES = 1 << 22
_TEXTS = (
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
_SUFFIXES = {
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
_NOTES = ("readme", "license", "licence", "thumbs.db", "desktop.ini")


@dataclass(frozen=True)
class Unused:
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

    __repr__ = by_fields

    def __str__(self) -> str:
        """Describe the entry for people."""
        several = f" ({self.count} files)" if self.count > 1 else ""
        return f"{self.name}{several}" + (f" looks like {self.looks_like}" if self.looks_like else "")


def unused(scan: Scan) -> tuple[Unused, ...]:
    """List the files below a scan's folder that were not read."""
    if scan.folder is None or not scan.folder.is_dir() or not scan.read_from:
        return ()
    known = {os.path.realpath(path) for path in scan.read_from}
    files = []
    for path in islice(_files(scan.folder), _MOST_FILES):
        # Links can lead to the same file twice, or to a folder that contains itself.
        if (real := os.path.realpath(path)) not in known:
            known.add(real)
            files.append(path)
    kinds: dict[tuple[Path, str], list[str]] = defaultdict(list)
    for path in files:
        kinds[path.parent, path.suffix.lower()].append(path.stem)
    # Warnings from trial reads are not about the scan.
    with only_looking(), collecting(forward=False):
        found = [
            Unused(path.relative_to(scan.folder).as_posix(), 1, _looks_like(path, scan))
            for path in files
            if len(kinds[path.parent, path.suffix.lower()]) <= _most_alone(path.suffix.lower())
        ]
    several = [
        Unused(
            (place / f"{_beginning(stems)}*{suffix}").relative_to(scan.folder).as_posix(),
            len(stems),
            _kind_of(place, suffix),
        )
        for (place, suffix), stems in kinds.items()
        if len(stems) > _most_alone(suffix)
    ]
    return tuple(sorted([*found, *several], key=lambda one: (not one.looks_like, one.name)))


def _files(folder: Path) -> Iterator[Path]:
    """Yield the files below a folder; linked folders are visited once."""
    seen = {os.path.realpath(folder)}
    waiting = [folder]
    while waiting:
        place = waiting.pop(0)
        for path in _listed(place):
            if path.is_file():
                yield path
            elif path.is_dir() and (real := os.path.realpath(path)) not in seen:
                seen.add(real)
                waiting.append(path)


def _listed(place: Path) -> list[Path]:
    try:
        found = sorted(place.iterdir())
    except OSError:
        return []
    return [one for one in found if one.name[0] != "." and not one.name.lower().startswith(_NOTES)]


def _beginning(stems: Sequence[str]) -> str:
    """Return the common prefix of file names, without trailing digits."""
    # The common prefix of the first and last name in sorted order is shared by all names.
    both = takewhile(lambda pair: pair[0] == pair[1], zip(min(stems), max(stems), strict=False))
    return "".join(one for one, _ in both).rstrip("0123456789")


def _most_alone(suffix: str) -> int:
    return _TEXTS_ALONE if suffix in _TEXTS else _ALONE


def _kind_of(place: Path, suffix: str) -> str:
    if suffix in IMAGES and "mask" in place.name.lower():
        return f"masks: scan.masks={place.name}"
    if suffix in IMAGES and "conf" in place.name.lower():
        return "confidence maps"
    if suffix in DEPTHS and place.name.lower().startswith("disp"):
        return "ground-truth disparities"
    return "images" if suffix in IMAGES else _SUFFIXES.get(suffix, "")


def _looks_like(path: Path, scan: Scan) -> str:
    """Guess the content of a file, and the option that reads it."""
    suffix = path.suffix.lower()
    if path.stem.lower().startswith("disp") and suffix in DEPTHS:
        return "ground-truth disparities"
    if suffix in IMAGES:
        return "an image"
    if suffix not in _TEXTS or path.stat().st_size > _MAX_BYTES:
        return _SUFFIXES.get(suffix, "")
    if (count := _poses_in(path)) > 1:
        return f"{count} poses: scan.poses={path.name}"
    if path.suffix == ".txt" and _reads(lambda: read_associations(path)):
        return "pairs of colour and depth images, which this layout does not need"
    if _reads(lambda: with_adjusted(scan, path)):
        return f"a result of adjust: scan.adjusted={path.name}"
    camera = scan.frames[0].camera
    size = camera.width, camera.height
    if scan.is_stereo and _reads(lambda: rig_calibration.read_rig(path, *size)):
        return f"a stereo calibration: scan.calibration={path.name}"
    if not _reads(lambda: calibration.read_camera(path, *size)):
        return ""
    return (
        "the calibration of a single camera"
        if scan.is_stereo
        else f"a camera calibration: scan.calibration={path.name}"
    )


def _reads(read: Callable[[], object]) -> bool:
    try:
        read()
    except InputError:
        return False
    return True


def _poses_in(path: Path) -> int:
    try:
        return len(trajectories.read_trajectory(path))
    except InputError:
        return 0
