"""Options of `run`, which `batch` has too, and the configuration that they come to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanloom.cli import completing
from scanloom.cli.codes import BATCH_OPTIONS_CONFLICT
from scanloom.cli.quality import config_of
from scanloom.stages.diagnostics.errors import UsageError

if TYPE_CHECKING:
    from scanloom.pipeline.config import Config

LIMITS_PANEL = "What it may take"

ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", help="Parameters as TOML; see scanloom config.", show_default=False
    ),
]
SetOption = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="STAGE.PARAM=VALUE",
        autocompletion=completing.settings,
        help="Change one parameter, after --quality and --config; may be given many times.",
        show_default=False,
    ),
]
UntilOption = Annotated[
    str | None,
    typer.Option(
        metavar="STAGE",
        help="Stop after this stage.",
        autocompletion=completing.stage_names,
        show_default=False,
    ),
]
ForceOption = Annotated[
    list[str] | None,
    typer.Option(
        metavar="STAGE",
        autocompletion=completing.stage_names,
        help="Run this stage even though its result is cached; may be given many times.",
        show_default=False,
    ),
]
OverwriteOption = Annotated[
    bool,
    typer.Option(
        "--overwrite",
        help="Also replace files in OUT that no run has placed there, or that were changed since.",
    ),
]
CacheOption = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Where the results of stages are kept; $SCANLOOM_CACHE, or OUT/cache, if not given.",
        show_default=False,
    ),
]
PageOption = Annotated[
    bool | None,
    typer.Option(
        "--page/--no-page",
        help="Write report.html, a page that shows the result, which is the default. As report.page.",
        show_default=False,
    ),
]
ReportOption = Annotated[
    bool | None,
    typer.Option(
        "--report/--no-report",
        help="Measure the result and draw it, which is the default; without, there is no page either. "
        "As report.enabled.",
        show_default=False,
    ),
]
MemoryOption = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Memory that may be taken, such as 8 GB (a number alone is MB). What needs more ends and says "
        "what would fit; no parameter is changed for it.",
        rich_help_panel=LIMITS_PANEL,
        show_default=False,
    ),
]
DiskOption = Annotated[
    str | None,
    typer.Option(
        metavar="SIZE",
        help="Disk that may be written, results and cache together, such as 20 GB. What needs more ends and "
        "says what would fit.",
        rich_help_panel=LIMITS_PANEL,
        show_default=False,
    ),
]


def run_config(
    file: Path | None,
    quality: str | None,
    settings: Sequence[str] | None,
    scan: dict[str, Any],
    page: bool | None,
    report: bool | None,
) -> Config:
    """Return the configuration that options come to, checked as far as it can be without a scan."""
    from scanloom.stages.simplification.auto import chosen

    config = config_of(file, quality)
    switched = {"report.page": page, "report.enabled": report}
    switches = [f"{name}={str(on).lower()}" for name, on in switched.items() if on is not None]
    config = config.set((*(settings or ()), *switches))
    config = replace(config, scan=replace(config.scan, **scan))
    chosen(config.simplify)  # what does not go together is said now, not after hours of fusion
    return config


def bytes_or_none(size: str | None, option: str) -> int | None:
    """Return a size that was given in bytes.

    Raises
    ------
    UsageError
        If it is no size, or none at all.
    """
    from scanloom.pipeline.cache.cache_size import bytes_of

    if size is None:
        return None
    count = bytes_of(size, option)
    if count == 0:
        raise UsageError(
            BATCH_OPTIONS_CONFLICT,
            "a limit of nothing ({option} {size}) lets no scan through",
            remedy="leave it out.",
            option=option,
            size=size,
        )
    return count
