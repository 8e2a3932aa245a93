"""Atomic file writes with locked drafts."""

from __future__ import annotations

import glob
import shutil
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from scanloom.pipeline.cache.locks import FileLock, take_lock, try_lock
from scanloom.pipeline.cache.system import flush
from scanloom.stages.files.atomic_files import create_draft_path, get_draft_stem
from scanloom.stages.files.atomic_rename import rename_atomically


def flush_all(paths: Iterable[Path]) -> None:
    """Flush files to disk in parallel.

    Flushing waits for the disk, not for the CPU.
    """
    with ThreadPoolExecutor(8) as threads:
        list(threads.map(flush, paths))


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file atomically: readers see the old or the new content."""
    _replace(path, lambda draft: draft.write_bytes(data))


def copy_atomically(source: Path, path: Path) -> None:
    """Copy a file atomically: readers see the old or the new content."""
    _replace(path, lambda draft: shutil.copyfile(source, draft))


def _replace(path: Path, write: Callable[[Path], object]) -> None:
    remove_abandoned_drafts(path)
    draft, lock = _create_draft(path)
    try:
        write(draft)
        flush(draft)
        rename_atomically(draft, path)
    except BaseException:
        draft.unlink(missing_ok=True)
        raise
    finally:
        lock.release()


def _create_draft(path: Path) -> tuple[Path, FileLock]:
    while True:
        draft = create_draft_path(path)
        lock = take_lock(draft)
        if lock.matches_path(draft):
            return draft, lock
        # Another process removed the draft as abandoned before it was locked.
        lock.release()


def remove_abandoned_drafts(path: Path) -> None:
    """Remove drafts of a file left by killed processes."""
    for draft in path.parent.glob(f".{glob.escape(get_draft_stem(path.name))}.*.part"):
        lock = try_lock(draft) if draft.is_file() and not draft.is_symlink() else None
        if lock is not None:
            draft.unlink(missing_ok=True)
            lock.release()
