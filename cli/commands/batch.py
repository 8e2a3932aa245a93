"""The command `batch`: many scans, each as `run` has it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanloom.cli.batch_dry_run import tell_dry_run
from scanloom.cli.batch_options import (
    AUTO,
    JobsOption,
    TakeOverOption,
    ThreadsOption,
    TimeoutOption,
    ending_as_interrupted,
    jobs_wanted,
    worker_of,
)
from scanloom.cli.batch_result import tell_batch
from scanloom.cli.batch_watch import watching_batch
from scanloom.cli.codes import BATCH_OPTIONS_CONFLICT
from scanloom.cli.options import Changes
from scanloom.cli.output import Output
from scanloom.cli.paths import require_writable
from scanloom.cli.quality import QualityOption
from scanloom.cli.run_options import (
    CacheOption,
    ConfigOption,
    DiskOption,
    ForceOption,
    MemoryOption,
    OverwriteOption,
    PageOption,
    ReportOption,
    SetOption,
    UntilOption,
    bytes_or_none,
    run_config,
)
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS, BATCH_DASK, BATCH_SCANS_NOT_DONE
from scanloom.stages import ScanParams
from scanloom.stages.diagnostics.errors import InputError, UsageError

DASK_PANEL = "Dask"

if TYPE_CHECKING:
    from scanloom.pipeline.batch.finding import NoScan
    from scanloom.pipeline.config import Config


def batch(
    folder: Annotated[
        Path,
        typer.Argument(metavar="SCANS", help="Folder that holds the scans.", show_default=False),
    ],
    target: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="OUT", help="Folder for the results.", show_default=False),
    ],
    scan_options: Changes[ScanParams],
    out: Output,
    include: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Only scans whose name matches, such as 'floor-2/*'; may be given many times.",
            show_default=False,
        ),
    ] = None,
    exclude: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN", help="No scan whose name matches; may be given many times.", show_default=False
        ),
    ] = None,
    config_file: ConfigOption = None,
    quality: QualityOption = None,
    settings: SetOption = None,
    until: UntilOption = None,
    force: ForceOption = None,
    overwrite: OverwriteOption = False,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run",
            help="Only say what would be done, and write nothing: the scans, how many of their stages are "
            "cached, and the seconds and memory to expect.",
        ),
    ] = False,
    cache: CacheOption = None,
    page: PageOption = None,
    report: ReportOption = None,
    jobs: JobsOption = AUTO,
    threads: ThreadsOption = None,
    memory: MemoryOption = None,
    disk: DiskOption = None,
    timeout: TimeoutOption = None,
    queue_only: Annotated[
        bool,
        typer.Option("--queue-only", help="Only write the queue into OUT, for scanloom worker OUT, and end."),
    ] = False,
    take_over_after: TakeOverOption = None,
    executor: Annotated[
        str,
        typer.Option(
            metavar="own|dask",
            help="Who runs the scans: workers of our own, or Dask, which the extra dask installs.",
            rich_help_panel=DASK_PANEL,
        ),
    ] = "own",
    scheduler: Annotated[
        str | None,
        typer.Option(
            metavar="ADDRESS|SYSTEM",
            help="Of Dask: the address of a scheduler that runs, as tcp://host:8786; or slurm, pbs, sge, "
            "lsf, oar or htcondor, by which dask-jobqueue starts --jobs workers as its configuration says.",
            rich_help_panel=DASK_PANEL,
            show_default=False,
        ),
    ] = None,
) -> None:
    """Make a mesh from every scan in a folder, each in OUT/<scan> under the names that run uses.

    Scans are found by what the readers recognise, in folders within folders too, and what is no scan is
    named. A scan that fails or hangs ends none of the others: the table says why, and the exit code is 1.
    index.html lists all results with pictures, figures and warnings; batch.csv has the same for programs. A
    second batch does only what has changed since; one that was broken off goes on where it was.

    With --queue-only any number of machines share the work: scanloom worker OUT on each.

    Example: scanloom batch scans -o out --memory '16 GB' --set simplify.max_shape=0.005
    """
    from scanloom.pipeline.batch.opening import open_queue
    from scanloom.pipeline.batch.outputs import require_replaceable, withdraw_outputs
    from scanloom.pipeline.batch.queue import Settings, jobs_of
    from scanloom.pipeline.own_paths import from_there
    from scanloom.pipeline.run.run import cache_folder

    sizes = bytes_or_none(memory, "--memory"), bytes_or_none(disk, "--disk")
    jobs_wanted(jobs)
    if queue_only and (dry_run or (jobs, threads, *sizes) != (AUTO, None, None, None)):
        raise UsageError(
            BATCH_OPTIONS_CONFLICT,
            "--queue-only works on nothing",
            remedy="give --jobs, --threads, --memory and --disk to scanloom worker.",
        )
    _require_executor(executor, scheduler)
    config = _portable(run_config(config_file, quality, settings, scan_options, page, report))
    _require_stages(until, force)
    folder, target = folder.resolve(), target.resolve()
    where = cache_folder(target, cache)
    if where == folder or target == folder:
        raise UsageError(
            BATCH_ALREADY_EXISTS,
            "results and cache cannot stand among the scans",
            remedy="name other folders.",
            where=folder,
        )
    scans, others = _found(folder, config, include, exclude, [target, where])
    require_writable(target)
    if not overwrite:
        require_replaceable(target)
    _tell_others(others, out)
    queued = jobs_of(scans, target)
    what = Settings(
        config=config.dumps(),
        until=until,
        force=tuple(force or ()),
        overwrite=overwrite,
        cache=from_there(where, target),
        **({} if take_over_after is None else {"take_over_after": take_over_after}),
        **({} if timeout is None else {"timeout": timeout}),
    )
    more = {"no_scans": [{"folder": str(one.place), "reason": one.reason} for one in others]}
    if dry_run:
        tell_dry_run(target, what, queued, config, more, out)
        return
    queue = open_queue(target, what, queued)
    withdraw_outputs(target)
    if queue_only:
        figures = {"out": str(target), "queued": len(queued), **more}
        text = f"{len(queued):,} scans queued; any machine works on them with: scanloom worker {target}"
        out.result(figures, text)
        return
    with ending_as_interrupted(), watching_batch(out) as tell:
        if scheduler is not None:
            from scanloom.pipeline.batch.dask import work_by_dask

            work_by_dask(
                queue,
                scheduler,
                workers=jobs_wanted(jobs),
                threads=threads or 1,
                memory=sizes[0],
                disk=sizes[1],
                take_over_after=take_over_after,
                tell=tell,
            )
        else:
            worker_of(queue, jobs, threads, *sizes, take_over_after, timeout, tell, out).work()
    tell_batch(queue, out, more)


def _require_executor(executor: str, scheduler: str | None) -> None:
    if executor not in ("own", "dask"):
        raise UsageError(BATCH_DASK, "--executor is {executor!r}; it must be own or dask.", executor=executor)
    if executor == "dask" and scheduler is None:
        raise UsageError(
            BATCH_DASK,
            "--executor dask needs --scheduler: an address, or slurm, pbs, sge, lsf, oar or htcondor.",
        )
    if executor == "own" and scheduler is not None:
        raise UsageError(BATCH_DASK, "--scheduler is Dask's", remedy="give --executor dask with it.")


def _portable(config: Config) -> Config:
    """Return the configuration with files that stand here named in full: who works on it is elsewhere."""
    named = {
        "scan": ("poses", "calibration", "masks", "adjusted"),
        "photos": ("poses", "calibration", "masks", "adjusted"),
        "texture": ("images",),
        "depth": ("model",),
    }
    for section, names in named.items():
        params = getattr(config, section)
        values = {name: getattr(params, name) for name in names}
        # What is not here is looked for in each scan's folder.
        there = {name: str(Path(one).resolve()) for name, one in values.items() if one and Path(one).exists()}
        config = replace(config, **{section: replace(params, **there)})
    return config


def _require_stages(until: str | None, force: list[str] | None) -> None:
    from scanloom.pipeline.run.run import require_stages

    require_stages([*(force or ()), *([until] if until is not None else [])])


def _found(
    folder: Path,
    config: Config,
    include: list[str] | None,
    exclude: list[str] | None,
    besides: list[Path],
) -> tuple[list[tuple[Path, str]], list[NoScan]]:
    from scanloom.pipeline.batch.finding import find_scans

    found, others = find_scans(
        folder,
        layout=config.scan.layout,
        include=include or (),
        exclude=exclude or (),
        besides=besides,
    )
    if not found:
        why = f"; {others[0].place.name}: {others[0].reason}" if others else ""
        which = " that is asked for" if include or exclude else ""
        raise InputError(
            BATCH_SCANS_NOT_DONE, "there is no scan{which} in it{why}.", folder, which=which, why=why
        )
    return [(one.place, one.name) for one in found], others


def _tell_others(others: list[NoScan], out: Output) -> None:
    for one in others:
        out.remark(f"no scan: {one.place}: {one.reason}")
