"""Validation of the files of a queue, which is in a folder that other users and machines may write to.

A worker only accepts what `scanloom batch` could have written, and only writes below OUT and to a cache.
"""

from __future__ import annotations

import math
import os
import stat
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

from scanloom.pipeline.batch.codes import BATCH_QUEUE_REFUSED
from scanloom.pipeline.relative_paths import get_relative_path
from scanloom.stages.diagnostics.errors import InputError, ScanloomError
from scanloom.stages.files.path_safety import is_safe_relative_path, resolve_path

# File that marks a folder as a cache.
_CACHE_MARK = "CACHEDIR.TAG"
_REMEDY = "if you trust the folder, run `scanloom batch` again: it rewrites the queue and keeps all results."


def require_trusted_files(out: Path, paths: Iterable[Path]) -> None:
    """Refuse a queue with links, or with files of a user other than this one, root and the owner of OUT.

    Raises
    ------
    InputError
        For the first such file. Missing files are accepted.
    """
    owners = {out.stat().st_uid, 0} | ({os.geteuid()} if hasattr(os, "geteuid") else set())
    for path in paths:
        try:
            status = path.lstat()
        except OSError:
            continue
        if stat.S_ISLNK(status.st_mode):
            raise InputError(BATCH_QUEUE_REFUSED, "the queue contains a link", path, remedy=_REMEDY)
        if status.st_uid not in owners:
            raise InputError(BATCH_QUEUE_REFUSED, "this file belongs to another user", path, remedy=_REMEDY)


def require_valid_settings(about: Mapping[str, Any], out: Path, path: Path) -> None:
    """Refuse settings that `scanloom batch` does not write.

    Parameters
    ----------
    about : settings by name.
    path : file of the queue, for messages.

    Raises
    ------
    InputError
        For the first such setting.
    """
    reason = _find_invalid_setting(about) or _find_cache_problem(about["cache"], out)
    if reason is not None:
        raise InputError(BATCH_QUEUE_REFUSED, "{reason}", path, remedy=_REMEDY, reason=reason)


def find_job_problem(scan: object, name: object, out: Path, reserved_names: frozenset[str]) -> str | None:
    """Return why `scanloom batch` does not write such a job; None if it could have."""
    if not isinstance(scan, str) or not isinstance(name, str) or "\0" in scan:
        return "its scan or its name is not text"
    if not is_safe_relative_path(name) or PurePosixPath(name).as_posix() != name:
        return f"its results {name[:100]!r} would be outside the output folder"
    if name.partition("/")[0].casefold() in reserved_names:
        return f"its results {name[:100]!r} would replace files of the batch"
    if get_relative_path(Path(os.path.normpath(out / scan)), out) != scan:
        return f"its scan {scan[:100]!r} is not a path relative to the output folder"
    return None


def is_inside(path: Path, folder: Path) -> bool:
    """Return True if a path is below a folder after all links are followed."""
    return resolve_path(path).is_relative_to(resolve_path(folder))


def _find_invalid_setting(about: Mapping[str, Any]) -> str | None:
    from scanloom.pipeline.config import Config
    from scanloom.pipeline.run.run import check_stages

    force, until = about["force"], about["until"]
    seconds = (about["take_over_after"], about["timeout"])
    if not all(type(value) in (int, float) and math.isfinite(value) and value >= 0 for value in seconds):
        return "a duration in its settings is not a number of seconds"
    if not (
        isinstance(about["cache"], str) and "\0" not in about["cache"] and type(about["overwrite"]) is bool
    ):
        return "its settings have values of a wrong type"
    wanted = [*force, *([] if until is None else [until])] if isinstance(force, list) else [None]
    stages = [stage for stage in wanted if isinstance(stage, str)]
    if len(stages) < len(wanted) or not isinstance(about["config"], str):
        return "its settings have values of a wrong type"
    try:
        check_stages(stages)
        Config.loads(about["config"])
    except ScanloomError as error:
        return f"its configuration is invalid: {error}"
    return None


def _find_cache_problem(cache: str, out: Path) -> str | None:
    folder = Path(os.path.normpath(out / cache))
    if get_relative_path(folder, out) != cache:
        return f"its cache {cache[:100]!r} is not a path relative to the output folder"
    if is_inside(folder, out) or (folder / _CACHE_MARK).is_file():
        return None
    return f"its cache {folder} is outside the output folder and has no file {_CACHE_MARK}"
