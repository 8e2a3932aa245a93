"""Number of concurrent jobs, from cores and memory."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from statistics import median

from scanloom.pipeline.batch.queue import Queue
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.needs import expected_of
from scanloom.pipeline.run.run import wanted_of
from scanloom.stages.diagnostics.errors import ScanloomError
from scanloom.stages.inspecting.system import memory_bytes

# Number of scans whose needs are estimated.
_SAMPLE = 8
# Ratio of the free memory that jobs may use: estimates can be wrong, and other programs need memory, too.
_SHARE = 0.9


def memory_to_use() -> int | None:
    """Return the bytes of memory for all jobs.

    Returns None if the system does not report its memory.
    """
    total, free = memory_bytes()
    known = free if free is not None else total
    return None if known is None else int(_SHARE * known)


def jobs_at_once(needs: Sequence[int], memory: int | None, cores: int) -> int:
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


def expected_needs(queue: Queue) -> list[int]:
    """Estimate the memory in bytes of up to 8 jobs.

    The jobs are spaced evenly over the queue.
    """
    jobs = queue.jobs
    count = min(_SAMPLE, len(jobs))
    chosen = [jobs[(2 * k + 1) * len(jobs) // (2 * count)] for k in range(count)]
    config = Config.loads(queue.settings.config)
    needs = []
    for job in chosen:
        need = _need(queue.scan_of(job), queue.results_of(job), config, queue)
        if need is not None:
            needs.append(need)
    return needs


def _need(scan: Path, out: Path, config: Config, queue: Queue) -> int | None:
    try:
        wanted = wanted_of(scan, out, config, queue.settings.until, (), Cache(queue.cache))
    except (ScanloomError, OSError):
        return None
    expected = expected_of(wanted.scan, wanted.config, wanted.planned, queue.cache)
    return max(one.memory_bytes for one in expected.values())
