"""Digests for cache keys: of canonical parameters, of file contents, and of a scan.

Digests only depend on content. Paths and modification times are excluded, so that a moved or touched scan
keeps its results. Frame names, time stamps and facts about the world frame have separate digests, for the
stages whose results contain them.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scanloom.pipeline.relative_paths import get_base_folder, get_relative_path
from scanloom.stages.diagnostics.codes import MACHINE_BUSY
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.input_files import open_input
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.scans.model.prefetch import map_ordered
from scanloom.stages.scans.model.scan import Frame, PackedImage, Scan
from scanloom.stages.scans.model.threads import get_thread_count

# Fields excluded from the frame digest, because most stages ignore them; see `compute_label_digests`.
_LABEL_FIELDS = frozenset({"name", "timestamp", "up"})
_BLOCK_BYTES = 1 << 20
# Files digested ahead of the one requested first: enough to keep all cores busy.
_READ_AHEAD = 256

_Signature = tuple[int, ...] | None


def to_canonical_json(value: Any) -> str:
    """Serialise a value as canonical JSON: equal values give equal text.

    Raises
    ------
    TypeError, ValueError
        For values JSON cannot express: paths, arrays, sets, keys that are not text, NaN, infinity. An
        approximate conversion could cause a wrong cache hit.
    """
    _check_json(value, "value")
    return json.dumps(value, sort_keys=True, separators=(",", ":"), allow_nan=False)


def _check_json(value: Any, where: str) -> None:
    if value is None or type(value) in (bool, int, str):
        return
    if type(value) is float:
        if not math.isfinite(value):
            raise ValueError(f"{where} is {value}, which JSON cannot express")
    elif type(value) in (list, tuple):
        for i, item in enumerate(value):
            _check_json(item, f"{where}[{i}]")
    elif type(value) is dict:
        for key, item in value.items():
            if type(key) is not str:
                raise TypeError(f"{where} has the key {key!r}, which JSON cannot express")
            _check_json(item, f"{where}.{key}")
    else:
        raise TypeError(f"{where} is of type {type(value).__name__}, which JSON cannot express")


def compute_digest(value: Any) -> str:
    """Compute the SHA-256 of the canonical JSON of a value, in hex."""
    return hashlib.sha256(to_canonical_json(value).encode()).hexdigest()


def compute_file_digest(path: Path) -> str:
    """Compute the SHA-256 of a file, in hex."""
    sha = hashlib.sha256()
    with open_input(path) as file:
        while block := file.read(_BLOCK_BYTES):
            sha.update(block)
    return sha.hexdigest()


def compute_file_digests(paths: Iterable[Path]) -> list[str]:
    """Compute the SHA-256 of many files on all cores."""
    return list(_map_on_all_cores(compute_file_digest, paths))


@dataclass(frozen=True)
class ScanDigest:
    """Content digest of a scan.

    Attributes
    ----------
    digest : digest of everything a stage may read.
    parts : digest of each frame and of the rig, by name, to report which of them changed between two runs.
    """

    digest: str
    parts: Mapping[str, str]
    _files: Mapping[Path, tuple[str, _Signature]]

    def require_unchanged(self, frames: Iterable[Frame] | None = None) -> None:
        """Raise StageError if a file of the scan changed since its digest was computed.

        A result computed from such a file must not be stored: its cache key would refer to different content.

        Parameters
        ----------
        frames : frames of the scan whose files are checked; None for all.
        """
        paths = self._files if frames is None else _list_files(frames)
        for path in paths:
            before, signature = self._files[path]
            # Only read files whose size or time changed; a touched file with equal content is fine.
            if _get_signature(path) != signature and get_content_digest(path) != before:
                raise StageError(
                    MACHINE_BUSY,
                    "{path} changed while it was being read",
                    remedy="run again when the file is complete.",
                    path=path,
                )


def compute_scan_digest(scan: Scan, progress: Progress = ignore_progress) -> ScanDigest:
    """Compute the digest of poses, cameras, scales and all image files of a scan.

    An unreadable file gets the digest "unreadable"; the stage that reads the file decides how to handle the
    error.
    """
    paths = sorted(_list_files(scan.frames))
    signatures = [_get_signature(path) for path in paths]
    contents: dict[Path, str] = {}
    for path, one in zip(paths, _map_on_all_cores(get_content_digest, paths), strict=True):
        contents[path] = one
        progress(len(contents), len(paths))
    parts = {"calibration": compute_digest(_to_plain(scan.rig, contents))}
    if scan.bounding_box is not None:
        parts["bounding box"] = compute_digest(_to_plain(scan.bounding_box, contents))
    for number, frame in enumerate(scan.frames):
        parts[f"frame {number} ({frame.name})"] = compute_digest(_to_plain_frame(frame, contents))
    files = {path: (contents[path], signature) for path, signature in zip(paths, signatures, strict=True)}
    return ScanDigest(compute_digest(list(parts.values())), parts, files)


def _map_on_all_cores(work: Callable[[Path], str], paths: Iterable[Path]) -> Iterator[str]:
    return map_ordered(work, paths, threads=get_thread_count(), max_pending=_READ_AHEAD)


def _list_files(frames: Iterable[Frame]) -> set[Path]:
    held = [v.file if isinstance(v, PackedImage) else v for frame in frames for v in vars(frame).values()]
    return {value for value in held if isinstance(value, Path)}


def compute_label_digests(scan: Scan) -> dict[str, str]:
    """Compute digests of frame metadata.

    Each digest is for the stages that use the metadata.

    Returns
    -------
    `names` : digest of frame names and file paths relative to the scan folder.
    `times` : digest of the time stamps.
    `world` : digest of the up directions and of `is_metric`.
    """
    names = [
        [frame.name, *(_get_relative_path(value, scan.folder) for value in vars(frame).values())]
        for frame in scan.frames
    ]
    world = [
        scan.up and scan.up.to_dict(),
        [_to_plain(frame.up, {}) for frame in scan.frames],
        scan.is_metric,
    ]
    times = [frame.timestamp for frame in scan.frames]
    return {"names": compute_digest(names), "times": compute_digest(times), "world": compute_digest(world)}


def _get_relative_path(value: Any, folder: Path | None) -> str | None:
    file = value.file if isinstance(value, PackedImage) else value
    if not isinstance(file, Path):
        return None
    # Relative to the scan folder, so that a moved scan keeps its results.
    return str(file) if folder is None else get_relative_path(file, get_base_folder(folder))


def get_content_digest(path: Path) -> str:
    """Return the digest of a file, or "unreadable"."""
    try:
        return compute_file_digest(path)
    except OSError:
        return "unreadable"


def _get_signature(path: Path) -> _Signature:
    try:
        stat = path.stat()
    except OSError:
        return None
    return stat.st_size, stat.st_mtime_ns, stat.st_ino


def _to_plain_frame(frame: Frame, contents: Mapping[Path, str]) -> dict[str, Any]:
    names = [f.name for f in dataclasses.fields(frame) if f.name not in _LABEL_FIELDS]
    # Frames without a depth correction keep the digest from before this field existed.
    names = [name for name in names if name != "depth_correction" or frame.depth_correction is not None]
    return {name: _to_plain(getattr(frame, name), contents) for name in names}


def _to_plain(value: Any, contents: Mapping[Path, str]) -> Any:
    if isinstance(value, Path):
        return {"file": contents[value]}
    if isinstance(value, PackedImage):
        return {"file": contents[value.file], "name": value.name}
    if isinstance(value, np.ndarray):
        data = np.ascontiguousarray(value)
        return {
            "dtype": data.dtype.str,
            "shape": list(value.shape),
            "bytes": hashlib.sha256(data.data).hexdigest(),
        }
    if isinstance(value, np.generic):
        return value.item()
    if dataclasses.is_dataclass(value):
        return {f.name: _to_plain(getattr(value, f.name), contents) for f in dataclasses.fields(value)}
    if isinstance(value, (tuple, list)):
        return [_to_plain(item, contents) for item in value]
    return value
