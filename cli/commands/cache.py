"""Commands `cache ls`, `cache verify` and `cache prune`."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanloom.cli.exit_codes import FAILED
from scanloom.cli.output import Output, format_size, format_table
from scanloom.pipeline.cache.codes import MACHINE_CACHE_UNUSABLE
from scanloom.stages import InputError, UsageError
from scanloom.stages.params import check_parameters, param

if TYPE_CHECKING:
    from scanloom.pipeline.cache.store import Cache, ListedEntry


CacheFolder = Annotated[
    Path | None,
    typer.Argument(
        metavar="DIR",
        help="Cache folder, or output folder of a run. Default: $SCANLOOM_CACHE.",
        show_default=False,
    ),
]


_DAY = 86_400.0


@dataclass(frozen=True, kw_only=True)
class PruneParams:
    """Results to remove from a cache."""

    all: bool = param(False, "Also remove results that the latest run of an output folder uses.", common=True)
    older_than: float | None = param(
        None,
        "Also remove results that were last used longer ago, whether a run uses them or not.",
        unit="days",
        low=0,
        common=True,
    )
    max_size: str | None = param(
        None,
        "Remove only the least recently used results, until the rest is no larger than this, such as `20 GB` "
        "(a number alone is MB). Results of the latest run of an output folder stay.",
        common=True,
    )
    dry_run: bool = param(False, "Print what would be removed, and remove nothing.", common=True)

    def __post_init__(self) -> None:
        check_parameters(self)


def ls(out: Output, folder: CacheFolder = None) -> None:
    """List cached results: stage, key, size, last use.

    Example: scanloom cache ls
    """
    cache = _open_cache(folder)
    _print_entries(cache.folder, cache.ls(), out)


def verify(out: Output, folder: CacheFolder = None) -> None:
    """Verify all cached results.

    The exit code is 1 if a result is damaged; the next run that needs it repeats the stage.

    Example: scanloom cache verify
    """
    cache = _open_cache(folder)
    entries = cache.verify()
    _print_entries(cache.folder, entries, out)
    if any(entry.problem for entry in entries):
        raise typer.Exit(FAILED)


def prune(prune: PruneParams, out: Output, folder: CacheFolder = None) -> None:
    """Remove cached results that no latest run uses.

    Example: scanloom cache prune --max-size "20 GB"
    """
    from scanloom.pipeline.cache.cache_size import parse_size

    cache = _open_cache(folder)
    removed = cache.prune(
        unused=prune.max_size is None,
        older_than=0.0 if prune.all else None if prune.older_than is None else prune.older_than * _DAY,
        max_size=None if prune.max_size is None else parse_size(prune.max_size, "max_size"),
        dry_run=prune.dry_run,
        everywhere=True,
    )
    _print_entries(cache.folder, removed, out, "would be removed" if prune.dry_run else "removed")


def _open_cache(folder: Path | None) -> Cache:
    from scanloom.pipeline.cache.store import Cache
    from scanloom.pipeline.run.run import CACHE_VARIABLE, get_cache_folder

    if folder is None and CACHE_VARIABLE not in os.environ:
        raise UsageError(
            MACHINE_CACHE_UNUSABLE,
            "which cache? Give its folder, or the output folder of a run, or set {cache_variable}.",
            cache_variable=CACHE_VARIABLE,
        )
    chosen = Path(os.environ[CACHE_VARIABLE]) if folder is None else folder
    for place in (chosen, get_cache_folder(chosen)) if chosen.is_dir() else ():
        if (place / "CACHEDIR.TAG").is_file():
            return Cache(place)
    raise InputError(MACHINE_CACHE_UNUSABLE, "there is no cache here.", chosen)


def _print_entries(folder: Path, entries: Sequence[ListedEntry], out: Output, done: str = "kept") -> None:
    total = sum(entry.size for entry in entries)
    metrics = {
        "cache": str(folder),
        "entries": [
            {
                "stage": entry.stage,
                "key": entry.key,
                "size_bytes": entry.size,
                "last_used": entry.last_used.isoformat(timespec="seconds"),
                "in_latest_run": entry.in_latest_run,
                "problem": entry.problem,
            }
            for entry in entries
        ],
        "total_bytes": total,
    }
    rows = [["stage", "key", "size", "last used", "in latest run"]]
    for entry in entries:
        when = entry.last_used.astimezone().strftime("%Y-%m-%d %H:%M")
        rows.append(
            [
                entry.stage,
                entry.key[:12],
                format_size(entry.size),
                when,
                "yes" if entry.in_latest_run else "no",
            ]
        )
    lines = [format_table(rows)] if entries else []
    lines += [f"{e.stage}/{e.key[:12]} is damaged: {e.problem}" for e in entries if e.problem]
    lines.append(
        f"{len(entries)} result{'s' * (len(entries) != 1)} {done} in {folder}, {format_size(total)}."
    )
    out.result(metrics, "\n".join(lines))
