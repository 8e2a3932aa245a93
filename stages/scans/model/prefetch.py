"""Parallel prefetching, and concurrent execution of two functions."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.files.blas_memory import reserve_blas_buffers
from scanloom.stages.scans.model.threads import get_thread_count

# Maximum number of workers: more are limited by memory bandwidth, and each holds images in memory.
_MAX_WORKERS = 8

T = TypeVar("T")
R = TypeVar("R")
S = TypeVar("S")


def get_worker_count() -> int:
    """Return the default number of worker threads."""
    return min(get_thread_count(), _MAX_WORKERS)


def map_ordered(work: Callable[[T], R], items: Iterable[T], *, threads: int, max_pending: int) -> Iterator[R]:
    """Map a function over items in threads and yield the results in order.

    At most `max_pending` results are finished or in progress. An exception of `work` is raised in place of
    its result. Closing the iterator cancels pending items and waits for running ones. Diagnostics are emitted
    in the order of the items.

    Parameters
    ----------
    threads : number of worker threads. They only help if `work` releases the GIL, as OpenCV and file access
        do. With 1, the calling thread does the work.
    max_pending : maximum number of results in memory.
    """
    if threads == 1:
        yield from map(work, items)
        return

    def run_and_collect(item: T) -> tuple[R, list[Diagnostic]]:
        # Diagnostics are emitted later in item order, so that their order does not depend on threads.
        with collecting(forward=False) as diagnostics:
            return work(item), diagnostics

    reserve_blas_buffers(threads + 1)
    rest = iter(items)
    pool = ThreadPoolExecutor(threads, thread_name_prefix="read-ahead")
    pending: deque[Future[tuple[R, list[Diagnostic]]]] = deque()
    try:
        pending.extend(pool.submit(run_and_collect, item) for item in islice(rest, max_pending))
        while pending:
            result, diagnostics = pending.popleft().result()
            pending.extend(pool.submit(run_and_collect, item) for item in islice(rest, 1))
            emit(*diagnostics)
            yield result
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def run_concurrently(background: Callable[[], R], foreground: Callable[[], S]) -> tuple[R, S]:
    """Run one function in a thread while the caller runs the other.

    Returns both results. An exception of `background` is raised after `foreground` has finished. If only one
    thread may be used, the functions run one after the other. Diagnostics of `background` are emitted first.
    """
    if get_thread_count() == 1:
        return background(), foreground()
    reserve_blas_buffers(2)

    def run_and_collect() -> tuple[R, list[Diagnostic]]:
        with collecting(forward=False) as diagnostics:
            return background(), diagnostics

    with ThreadPoolExecutor(1, thread_name_prefix="beside") as pool:
        future = pool.submit(run_and_collect)
        with collecting(forward=False) as foreground_diagnostics:
            other = foreground()
        one, diagnostics = future.result()
    emit(*diagnostics, *foreground_diagnostics)
    return one, other
