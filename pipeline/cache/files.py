"""Atomic file writes with locked drafts."""

from __future__ import annotations

import glob
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from scanloom.pipeline.cache.locks import Lock, take_lock, try_lock
from scanloom.pipeline.cache.system import flush
from scanloom.stages.files.moving import move
from scanloom.stages.files.replacing import draft_of, stem_of_drafts


def flush_all(paths: Iterable[Path]) -> None:
    """Flush files to disk in parallel.

    Flushing waits for the disk, not for the CPU.
    """
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(flush, paths))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file atomically: readers see the old or the new content."""
    _replace(path, lambda draft: draft.write_bytes(data))


def copy_whole(source: Path, path: Path) -> None:
    """Copy a file atomically: readers see the old or the new content."""
    _replace(path, lambda draft: shutil.copyfile(source, draft))


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    remove_abandoned(path)
    draft, lock = _new_draft(path)
    try:
        write(draft)
        flush(draft)
        move(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    finally:
        lock.release()


def _new_draft(path: Path) -> tuple[Path, Lock]:
    while True:
        draft = draft_of(path)
        lock = take_lock(draft)
        if lock.is_of(draft):
            return draft, lock
        # Another process removed the draft as abandoned before it was locked.
        lock.release()


def remove_abandoned(path: Path) -> None:
    """Remove drafts of a file left by killed processes."""
    for draft in path.parent.glob(f".{glob.escape(stem_of_drafts(path.name))}.*.part"):
        lock = try_lock(draft) if draft.is_file() and not draft.is_symlink() else None
        if lock is not None:
            draft.unlink(missing_ok=True)
            lock.release()
