"""Output of `batch --dry-run`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scanloom.cli.output import Output, format_size, format_table
from scanloom.stages.diagnostics.errors import ScanloomError

if TYPE_CHECKING:
    from scanloom.pipeline.batch.job_queue import BatchSettings, Job
    from scanloom.pipeline.config import Config
    from scanloom.pipeline.run.dry_run import DryRun


def print_batch_plan(
    target: Path,
    what: BatchSettings,
    queued: tuple[Job, ...],
    config: Config,
    more: dict[str, Any],
    out: Output,
) -> None:
    """Print the stages, time and memory required by each scan of a batch, unreadable scans included."""
    from scanloom.pipeline.run.dry_run import DryRun, predict_run

    found: list[DryRun | ScanloomError] = []
    with out.progress("scans", "scans") as progress:
        for job in queued:
            how: dict[str, Any] = {
                "until": what.until,
                "force": what.force,
                "cache_dir": os.path.normpath(target / what.cache),
                "overwrite": what.overwrite,
            }
            try:
                scan = os.path.normpath(target / job.scan)
                found.append(predict_run(scan, target / job.name, config, **how))
            except ScanloomError as error:
                found.append(error)
            progress(len(found), len(queued))
    rows = [["scan", "layout", "frames", "stages", "cached", "seconds", "memory"]]
    lines, scans = [], []
    for job, one in zip(queued, found, strict=True):
        if not isinstance(one, DryRun):
            rows.append([job.name, "", "", "", "", "", ""])
            lines.append(f"{job.name}: {one}")
            scans.append({"scan": job.name, "error": str(one)})
            continue
        cached = sum(stage.cached for stage in one.stages)
        metrics = [f"{one.frames:,}", str(len(one.stages)), str(cached), f"{one.seconds:.1f}"]
        rows.append(
            [job.name, one.layout, *metrics, format_size(one.memory_bytes) if one.memory_bytes else ""]
        )
        scans.append({**one.to_dict(), "scan": job.name, **one.to_dict()["scan"]})
        lines += [f"{job.name}: would be rejected: {one.refusal_reason}"] if one.refusal_reason else []
    runs = [one for one in found if isinstance(one, DryRun)]
    seconds = sum(one.seconds for one in runs)
    most = max((one.memory_bytes for one in runs), default=0)
    total = (
        f"{len(queued):,} scans, about {seconds:,.0f} s one after another, "
        f"at most {format_size(most)} of memory per scan"
    )
    out.result(
        {
            "dry_run": True,
            "out": str(target),
            "scans": scans,
            "expected_seconds": round(seconds, 1),
            "expected_memory_mb": round(most / 1e6),
            **more,
        },
        "\n".join(
            [format_table(rows), "", *lines, *([""] if lines else []), f"{total}; nothing is written."]
        ),
    )
