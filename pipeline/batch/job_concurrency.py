"""Number of concurrent jobs, from cores and memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

from scanloom.pipeline.batch.job_queue import BatchQueue
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.resource_estimation import estimate_stages
from scanloom.pipeline.run.run import prepare_run
from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.inspecting.system import query_memory_bytes

# Number of scans whose needs are estimated.
_SAMPLED_JOBS = 8
# Ratio of the free memory that jobs may use: estimates can be wrong, and other programs need memory, too.
_MEMORY_RATIO = 0.9


def get_usable_memory() -> int | None:
    """Return the bytes of memory for all jobs.

    Returns None if the system does not report its memory.
    """
    total, free = query_memory_bytes()
    known = free if free is not None else total
    return None if known is None else int(_MEMORY_RATIO * known)


def compute_concurrency(needs: Sequence[int], memory: int | None, cores: int) -> int:
    """Compute how many jobs can run concurrently, at least one.

    Parameters
    ----------
    needs : expected memory in bytes of some jobs.
    memory : bytes for all jobs; None if unknown.
    cores : number of CPU cores.
    """
    if memory is None or not needs:
        return cores
    return max(min(int(memory // max(median(needs), 1)), cores), 1)


def estimate_job_memory(queue: BatchQueue) -> list[int]:
    """Estimate the memory in bytes of up to 8 jobs.

    The jobs are spaced evenly over the queue.
    """
    jobs = queue.jobs
    count = min(_SAMPLED_JOBS, len(jobs))
    chosen = [jobs[(2 * k + 1) * len(jobs) // (2 * count)] for k in range(count)]
    config = Config.loads(queue.settings.config)
    needs = []
    for job in chosen:
        need = _estimate_memory(queue.get_scan_path(job), queue.get_output_folder(job), config, queue)
        if need is not None:
            needs.append(need)
    return needs


def _estimate_memory(scan: Path, out: Path, config: Config, queue: BatchQueue) -> int | None:
    try:
        prepared = prepare_run(scan, out, config, queue.settings.until, (), Cache(queue.cache))
    except (ScanloomError, OSError):
        return None
    expected = estimate_stages(prepared.scan, prepared.config, prepared.planned_names, queue.cache)
    return max(one.memory_bytes for one in expected.values())
