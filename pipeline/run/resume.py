"""Continuation of a run with one more stage enabled."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.graph import STAGES
from scanloom.pipeline.report.file_names import REPORT
from scanloom.pipeline.run.codes import REPORT_NO_RUN
from scanloom.pipeline.run.events import RunEventHandler, ignore_run_event
from scanloom.pipeline.run.run import RunResult, get_cache_folder, run
from scanloom.pipeline.run.run_request import RunRequest
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.path_safety import resolve_path


def continue_run(
    out: Path,
    stage: str,
    changes: Mapping[str, Any],
    *,
    scan: Path | None = None,
    cache_dir: Path | None = None,
    events: RunEventHandler = ignore_run_event,
) -> RunResult:
    """Enable an optional stage of a finished run and run it.

    Other stages come from the cache.

    Parameters
    ----------
    out : output folder of a run that has written refined.ply.
    stage : stage whose section has the parameter `enabled`.
    changes : other parameters of the stage.
    scan : new location of the scan, if it was moved.
    cache_dir : cache of the run, as for `run`.

    Raises
    ------
    InputError
        If the folder has no results of a run, or the scan was moved.
    UsageError
        If a parameter is out of range.
    """
    request = _read_request(out, cache_dir)
    folder = request.scan if scan is None else scan
    if not folder.exists():
        raise InputError(
            REPORT_NO_RUN,
            "the scan of these results does not exist any more",
            folder,
            remedy="give its new location with --scan.",
        )
    section = replace(getattr(request.config, stage), enabled=True, **changes)
    config = replace(request.config, **{stage: section})
    order = [one.name for one in STAGES]
    until = max(request.until, stage, key=order.index)
    return run(folder, out, config, until=until, cache_dir=cache_dir, events=events)


def _read_request(out: Path, cache_dir: Path | None) -> RunRequest:
    if not out.exists():
        raise InputError(
            REPORT_NO_RUN, "there is no such folder", out, remedy="give the output folder of a run."
        )
    if not out.is_dir():
        raise InputError(REPORT_NO_RUN, "this is a file", out, remedy="give the output folder of a run.")
    cache = get_cache_folder(resolve_path(out), cache_dir)
    record = Cache(cache).read_latest_run(resolve_path(out)) if cache.is_dir() else {}
    request = RunRequest.from_record(record.get("asked"))
    if request is None and not (out / REPORT).is_file():
        raise InputError(
            REPORT_NO_RUN,
            "this folder has no results of a run",
            out,
            remedy="give the output folder of `scanloom run`.",
        )
    if request is None:
        raise InputError(
            REPORT_NO_RUN,
            "the cache {cache} has no record of this run",
            out,
            remedy="give the cache of the run, or run `scanloom run` again.",
            cache=cache,
        )
    if not (out / "refined.ply").is_file():
        raise InputError(
            REPORT_NO_RUN,
            "refined.ply is missing, because the run ended before it",
            out,
            remedy="complete the run with `scanloom run`.",
        )
    return request
