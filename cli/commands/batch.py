"""Command `batch`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanloom.cli.batch_dry_run import print_batch_plan
from scanloom.cli.batch_options import AUTO, WorkerParams, create_worker, sigterm_as_interrupt
from scanloom.cli.batch_progress import show_batch_progress
from scanloom.cli.batch_result import report_batch
from scanloom.cli.codes import BATCH_OPTIONS_CONFLICT
from scanloom.cli.output import Output
from scanloom.cli.paths import require_writable
from scanloom.cli.quality_option import QualityOption
from scanloom.cli.run_options import (
    ConfigOption,
    ConfigWords,
    DryRunOption,
    LimitsParams,
    OutOption,
    RunParams,
    UntilOption,
    load_run_config,
    split_words,
)
from scanloom.pipeline.batch.codes import BATCH_ALREADY_EXISTS, BATCH_SCANS_NOT_DONE
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.params import check_parameters, param

if TYPE_CHECKING:
    from scanloom.pipeline.batch.scan_discovery import FolderWithoutScan
    from scanloom.pipeline.config import Config


@dataclass(frozen=True, kw_only=True)
class BatchParams:
    """Parameters of `batch`: ignored scans and the Dask scheduler."""

    exclude: str | None = param(
        None, "Ignore scans whose name matches one of these patterns, such as `old/*,test-*`."
    )
    dask: str | None = param(
        None,
        "Process the scans with Dask (needs the extra `dask`): the address of a running scheduler, such as "
        "tcp://host:8786, or slurm, pbs, sge, lsf, oar or htcondor, where dask-jobqueue starts --jobs "
        "workers.",
    )

    def __post_init__(self) -> None:
        check_parameters(self)


def batch(
    folder: Annotated[
        Path,
        typer.Argument(metavar="SCANS", help="Folder that holds the scans.", show_default=False),
    ],
    target: OutOption,
    worker: WorkerParams,
    limits: LimitsParams,
    run: RunParams,
    batch: BatchParams,
    words: ConfigWords,
    out: Output,
    include: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATTERN",
            help="Process only scans whose name matches, such as 'floor-2/*'; may be repeated.",
            show_default=False,
        ),
    ] = None,
    config_file: ConfigOption = None,
    quality: QualityOption = None,
    until: UntilOption = None,
    dry_run: DryRunOption = False,
    queue_only: Annotated[
        bool,
        typer.Option("--queue-only", help="Write the queue for scanloom worker OUT, and process nothing."),
    ] = False,
) -> None:
    """Turn every scan in a folder into a mesh.

    OUT/SCAN gets the results of `scanloom run` for each scan. index.html shows all results with pictures,
    metrics and warnings; batch.csv has the metrics. Scans are found in nested folders, too; other folders
    are listed. If a scan fails, the others continue, the table has the reason, and the exit code is 1. A
    second batch only processes changed scans, and resumes an interrupted batch.

    --queue-only lets several machines share the work: run scanloom worker OUT on each.

    Example: scanloom batch scans -o out --set limits.memory='16 GB' --set simplify.max_shape=0.005
    """
    from scanloom.pipeline.batch.job_queue import BatchSettings, make_jobs
    from scanloom.pipeline.batch.open_batch import open_queue
    from scanloom.pipeline.batch.summary_files import check_outputs_replaceable, remove_outputs
    from scanloom.pipeline.cache.store import Cache
    from scanloom.pipeline.error_conversion import convert_os_errors
    from scanloom.pipeline.relative_paths import get_relative_path
    from scanloom.pipeline.run.run import get_cache_folder

    if queue_only and (dry_run or worker.jobs != AUTO or worker.threads or limits != LimitsParams()):
        raise UsageError(
            BATCH_OPTIONS_CONFLICT,
            "--queue-only processes nothing",
            remedy="give --jobs, worker.threads, limits.memory and limits.disk to scanloom worker.",
        )
    config = _portable(load_run_config(config_file, quality, words))
    _require_stages(until, run.forced)
    folder, target = resolve_path(folder), resolve_path(target)
    where = get_cache_folder(target, run.cache_folder)
    if where == folder or target == folder:
        raise UsageError(
            BATCH_ALREADY_EXISTS,
            "the output folder and the cache cannot be the folder of the scans",
            remedy="name other folders.",
            where=folder,
        )
    exclude = split_words(batch.exclude)
    scans, others = _find_scans(folder, config, include or (), exclude, [target, where])
    require_writable(target)
    if not run.overwrite:
        check_outputs_replaceable(target)
    _remark_others(others, out)
    queued = make_jobs(scans, target)
    what = BatchSettings(
        config=config.dumps(),
        until=until,
        force=run.forced,
        overwrite=run.overwrite,
        cache=get_relative_path(where, target),
        **({} if worker.worker_timeout is None else {"take_over_after": worker.worker_timeout}),
        **({} if worker.timeout is None else {"timeout": worker.timeout}),
    )
    more = {"no_scans": [{"folder": str(one.path), "reason": one.reason} for one in others]}
    if dry_run:
        print_batch_plan(target, what, queued, config, more, out)
        return
    queue = open_queue(target, what, queued)
    remove_outputs(target)
    with convert_os_errors(f"the cache {where} cannot be used"):
        # Workers accept a cache outside OUT only if it is marked as one.
        Cache(where).prepare()
    if queue_only:
        metrics = {"out": str(target), "queued": len(queued), **more}
        text = f"{len(queued):,} scans queued; start on each machine: scanloom worker {target}"
        out.result(metrics, text)
        return
    with sigterm_as_interrupt(), show_batch_progress(out) as tell:
        if batch.dask is not None:
            from scanloom.pipeline.batch.dask_executor import run_with_dask

            run_with_dask(
                queue,
                batch.dask,
                workers=worker.job_count,
                threads=worker.threads or 1,
                memory=limits.memory_bytes,
                disk=limits.disk_bytes,
                take_over_after=worker.worker_timeout,
                on_event=tell,
            )
        else:
            create_worker(queue, worker, limits, tell, out).run()
    report_batch(queue, out, more)


def _portable(config: Config) -> Config:
    """Return the configuration with absolute paths of existing files; workers run in other folders."""
    named = {
        "scan": ("poses", "calibration", "masks", "adjusted_cameras", "depth_calibration"),
        "photos": ("poses", "calibration", "masks", "adjusted_cameras", "depth_calibration"),
        "texture": ("images",),
        "depth": ("model",),
    }
    for section, names in named.items():
        params = getattr(config, section)
        values = {name: getattr(params, name) for name in names}
        # Paths that do not exist here are searched in the folder of each scan.
        there = {name: str(resolve_path(one)) for name, one in values.items() if one and Path(one).exists()}
        config = replace(config, **{section: replace(params, **there)})
    return config


def _require_stages(until: str | None, force: Sequence[str]) -> None:
    from scanloom.pipeline.run.run import check_stages

    check_stages([*force, *([until] if until is not None else [])])


def _find_scans(
    folder: Path,
    config: Config,
    include: Sequence[str],
    exclude: Sequence[str],
    besides: list[Path],
) -> tuple[list[tuple[Path, str]], list[FolderWithoutScan]]:
    from scanloom.pipeline.batch.scan_discovery import find_scans

    found, others = find_scans(
        folder,
        layout=config.scan.layout,
        include=include,
        exclude=exclude,
        excluded_folders=besides,
    )
    if not found:
        why = f"; {others[0].path.name}: {others[0].reason}" if others else ""
        which = " that --include and --exclude select" if include or exclude else ""
        raise InputError(
            BATCH_SCANS_NOT_DONE, "the folder contains no scan{which}{why}.", folder, which=which, why=why
        )
    return [(one.path, one.name) for one in found], others


def _remark_others(others: list[FolderWithoutScan], out: Output) -> None:
    for one in others:
        out.remark(f"not a scan: {one.path}: {one.reason}")
