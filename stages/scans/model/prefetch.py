"""Work in threads while the caller is busy: on the next items, or on one thing beside another."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.files.blas_buffers import require_buffers
from scanloom.stages.scans.model.threads import threads_to_use

# More threads than this wait for memory, and hold that many images.
_MOST_WORKERS = 8

T = TypeVar("T")
R = TypeVar("R")
S = TypeVar("S")


def workers() -> int:
    """Return how many threads are worth having."""
    return min(threads_to_use(), _MOST_WORKERS)


def read_ahead(work: Callable[[T], R], items: Iterable[T], *, threads: int, ahead: int) -> Iterator[R]:
    """Yield `work(item)` in the items' order, with at most `ahead` results finished or under way.

    An exception of `work` is raised where its result would have come. Closing the iterator early
    drops what has not begun and waits for what has.

    Parameters
    ----------
    threads : workers; `work` must release the GIL (as OpenCV and file reading do) for them to help. One is
        the caller itself: who asks for one thread gets one, whatever other cores are busy with.
    ahead : the bound on memory, in results.
    """
    if threads == 1:
        yield from map(work, items)
        return

    def collected(item: T) -> tuple[R, list[Diagnostic]]:
        # Emitted when their turn comes, so that their order does not depend on threads.
        with collecting(forward=False) as diagnostics:
            return work(item), diagnostics

    require_buffers(threads + 1)
    rest = iter(items)
    pool = ThreadPoolExecutor(threads, thread_name_prefix="read-ahead")
    pending: deque[Future[tuple[R, list[Diagnostic]]]] = deque()
    try:
        pending.extend(pool.submit(collected, item) for item in islice(rest, ahead))
        while pending:
            result, diagnostics = pending.popleft().result()
            pending.extend(pool.submit(collected, item) for item in islice(rest, 1))
            emit(*diagnostics)
            yield result
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def both(beside: Callable[[], R], here: Callable[[], S]) -> tuple[R, S]:
    """Return what two pieces of work return, the first done in a thread while the caller does the second.

    An exception of the first is raised once the second has ended. Where one thread is to be used, one comes
    after the other.
    """
    if threads_to_use() == 1:
        return beside(), here()
    require_buffers(2)

    def collected() -> tuple[R, list[Diagnostic]]:
        with collecting(forward=False) as diagnostics:
            return beside(), diagnostics

    with ThreadPoolExecutor(1, thread_name_prefix="beside") as pool:
        future = pool.submit(collected)
        other = here()
        one, diagnostics = future.result()
    emit(*diagnostics)
    return one, other
