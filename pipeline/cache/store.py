"""Cache of stage results, stored under the digests of their recipes.

    cache/
      CACHEDIR.TAG             excludes the folder from backups
      names.lock               held briefly while an entry is added, moved or looked up
      fuse/<key>/              entry: files of the stage, manifest.json and in-use.lock
      drafts/fuse-m1f0…-k3j2…/ entry being written or removed, locked by the process that does it
      runs/<output>.json       entries used by the latest run of each output folder
      runs/<output>.lock       held by the run that writes to the output folder

Entries are written in `drafts`, flushed to disk and renamed, so each entry is complete or absent. Readers of
an entry hold a shared lock on `in-use.lock`; removal needs an exclusive lock. The system releases the locks
of a killed process, so its drafts can be recognised as abandoned. If several machines share the cache, each
machine only removes its own drafts. On file systems without locks, entries are still complete or absent.

The content of the folder is not trusted. A link or a file in place of an entry or lock is removed. A link or
a file in place of a folder of entries is an error. Links are never followed. A read-only cache is used
without being updated.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.atomic_files import write_atomically
from scanloom.pipeline.cache.codes import MACHINE_CACHE_UNUSABLE
from scanloom.pipeline.cache.digest import compute_digest
from scanloom.pipeline.cache.entry import (
    IN_USE_LOCK,
    DamagedEntryError,
    Entry,
    Recipe,
    complete_entry,
    read_manifest,
    verify_entry,
)
from scanloom.pipeline.cache.host_id import get_host_id, is_from_another_host
from scanloom.pipeline.cache.locks import (
    READ_ONLY_ERRORS,
    FileLock,
    is_folder,
    take_folder_lock,
    take_lock,
    try_folder_lock,
    try_lock,
)
from scanloom.pipeline.cache.system import flush
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.relative_paths import get_relative_path
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.atomic_rename import rename_atomically
from scanloom.stages.files.input_files import read_input_text

_DRAFTS = "drafts"
_RUNS = "runs"
_KEY = re.compile("[0-9a-f]{64}")
_TAG = "Signature: 8a477f597d28d172789f06886806bc55\n# Results of scanloom; safe to delete.\n"


@dataclass(frozen=True)
class ListedEntry:
    """Entry as listed by `scanloom cache`.

    Attributes
    ----------
    size : bytes of all files.
    in_latest_run : True if the latest run of an output folder used the entry.
    problem : reason why the entry is damaged; None if intact.
    """

    stage: str
    key: str
    size: int
    last_used: datetime
    in_latest_run: bool
    manifest: Mapping[str, Any]
    problem: str | None = None


class Cache:
    """Folder of cache entries, safe for concurrent use by several processes.

    Parameters
    ----------
    folder : cache folder, created when the first entry is stored.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._is_read_only = False

    def get(self, recipe: Recipe) -> Entry | None:
        """Look up and verify the entry of a recipe; None if missing.

        A damaged entry is removed with a warning.
        """
        entry_path = self._get_entry_path(recipe)
        with convert_os_errors(f"the cache folder {self.folder} cannot be used"):
            while os.path.lexists(entry_path):
                with self._lock_names():
                    if not self._is_entry(entry_path):
                        break
                    lock = take_lock(entry_path / IN_USE_LOCK, shared=True)
                try:
                    manifest = verify_entry(entry_path)
                except DamagedEntryError as error:
                    if self._drop_damaged(entry_path, lock):
                        emit(
                            MACHINE_CACHE_UNUSABLE.warning(
                                "the cached result of {stage} is damaged ({reason}); the stage runs again.",
                                stage=recipe.stage,
                                reason=str(error),
                            )
                        )
                    continue
                except BaseException:
                    lock.release()
                    raise
                with contextlib.suppress(OSError):  # Read-only cache: the time of last use is not updated.
                    lock.touch()
                return Entry(entry_path, manifest, lock)
        return None

    def store(
        self, recipe: Recipe, make: Callable[[Path], Mapping[str, Any]], *, replace: bool = False
    ) -> Entry:
        """Compute and store an entry.

        Parameters
        ----------
        make : writes the files of the stage into a given empty folder and returns manifest fields: `metrics`,
            and `made` with seconds and memory, which do not affect the result.
        replace : replace an existing entry. If False and another process stored the entry first, that entry
            is returned and the new files are discarded.

        Raises
        ------
        StageError
            If the disk is full or the folder is not writable; no partial entry is left.
        """
        with convert_os_errors(f"the result of {recipe.stage} cannot be written to the cache {self.folder}"):
            draft, lock = self._create_draft(recipe.stage)
            try:
                complete_entry(draft, recipe, make(draft))
                while (held := self._publish(draft, self._get_entry_path(recipe), lock, replace)) is None:
                    winner = self.get(recipe)
                    if winner is not None:
                        _discard(draft, lock)
                        return winner
            except BaseException:
                _discard(draft, lock)
                raise
            if replace:
                self.remove_abandoned()
            return Entry(self._get_entry_path(recipe), read_manifest(self._get_entry_path(recipe)), held)

    def remove_abandoned(self, *, everywhere: bool = False) -> None:
        """Remove drafts of killed processes, and removed entries that were still being read.

        Parameters
        ----------
        everywhere : also remove drafts of other machines. Only safe if no other machine is using the cache,
            as the share may not support locks between machines.
        """
        with convert_os_errors(f"the cache folder {self.folder} cannot be used"):
            drafts = self.folder / _DRAFTS
            for draft in drafts.iterdir() if is_folder(drafts) else ():
                # Locks may only hold within one machine, so drafts of other machines could be in use.
                if is_from_another_host(draft.name) and not everywhere:
                    continue
                with self._lock_names():
                    # A draft is created and locked under the names lock, so an unlocked draft is abandoned.
                    lock = try_lock(draft / IN_USE_LOCK) if is_folder(draft) else None
                if lock is not None:
                    _discard(draft, lock)

    def ls(self) -> list[ListedEntry]:
        """List all entries by stage, most recently used first, without verifying files."""
        listed = self._list_entries(thorough=False)
        return sorted(listed, key=lambda entry: (entry.stage, -entry.last_used.timestamp()))

    def verify(self) -> list[ListedEntry]:
        """List all entries, reading every file to find damage; nothing is changed."""
        return self._list_entries(thorough=True)

    def prune(
        self,
        *,
        unused: bool = True,
        older_than: float | None = None,
        max_size: int | None = None,
        dry_run: bool = False,
        everywhere: bool = False,
    ) -> list[ListedEntry]:
        """Remove entries and return them; entries in use by other processes are kept.

        Parameters
        ----------
        unused : remove entries that no output folder's latest run used.
        older_than : remove entries last used more than this many seconds ago.
        max_size : then remove the least recently used entries until the cache is at most this many bytes.
            Entries used by latest runs are kept.
        dry_run : only return the entries that would be removed.
        everywhere : see `remove_abandoned_drafts`.
        """
        entries = sorted(self.ls(), key=lambda entry: entry.last_used)
        now = datetime.now(timezone.utc)
        chosen: list[ListedEntry] = []
        kept: list[ListedEntry] = []
        for entry in entries:
            old = older_than is not None and (now - entry.last_used).total_seconds() > older_than
            (chosen if old or (unused and not entry.in_latest_run) else kept).append(entry)
        if max_size is not None:
            total = sum(entry.size for entry in kept)
            for entry in [entry for entry in kept if not entry.in_latest_run]:
                if total <= max_size:
                    break
                chosen.append(entry)
                total -= entry.size
        if dry_run:
            return chosen
        with convert_os_errors(f"the cache folder {self.folder} cannot be pruned"):
            removed = [entry for entry in chosen if self._remove(entry)]
        self.remove_abandoned(everywhere=everywhere)
        return removed

    def limit_size(self, max_size: int) -> None:
        """Remove least recently used entries until the cache fits; keep entries of latest runs.

        Parameters
        ----------
        max_size : bytes. If the cache remains larger, a warning is emitted.
        """
        self.prune(unused=False, max_size=max_size)
        total = sum(entry.size for entry in self.ls())
        if total > max_size:
            emit(
                MACHINE_CACHE_UNUSABLE.warning(
                    "the cache {folder} has {total_gb:.3g} GB, more than cache.max_size ({limit_gb:.3g} GB): "
                    "all entries are in use, or belong to the latest run of an output folder.",
                    folder=self.folder,
                    total_gb=total / 1e9,
                    limit_gb=max_size / 1e9,
                )
            )

    def lock_output_folder(self, out: Path, on_wait: Callable[[], None]) -> FileLock:
        """Wait for exclusive use of an output folder; release the returned lock afterwards.

        Parameters
        ----------
        on_wait : called once if another run is using the folder.
        """
        with convert_os_errors(f"the cache folder {self.folder} cannot be used"):
            path = self._get_record_path(out).with_suffix(".lock")
            try:
                self.prepare()
                lock = try_lock(path)
            except OSError as error:
                if error.errno not in READ_ONLY_ERRORS:
                    raise
                return _lock_folder(out, on_wait)
            if lock is None:
                on_wait()
                lock = take_lock(path)
            return lock

    def record_run(self, out: Path, record: Mapping[str, Any]) -> None:
        """Record the latest run of an output folder; `record["keys"]` lists the used entries."""
        with convert_os_errors(f"the cache folder {self.folder} cannot be used"):
            text = json.dumps({"out": self._make_relative(out), **record}, indent=1)
            try:
                self.prepare()
                write_atomically(self._get_record_path(out), text.encode())
            except OSError as error:
                if error.errno not in READ_ONLY_ERRORS:
                    raise
                self._warn_read_only()

    def read_latest_run(self, out: Path) -> dict[str, Any]:
        """Return the record of the latest run of an output folder; empty if missing."""
        return _read_record(self._get_record_path(out))

    def _warn_read_only(self) -> None:
        if not self._is_read_only:
            self._is_read_only = True
            emit(
                MACHINE_CACHE_UNUSABLE.warning(
                    "the cache {folder} is read-only: its entries are used, but this run is not recorded.",
                    folder=self.folder,
                )
            )

    def _get_entry_path(self, recipe: Recipe) -> Path:
        _check_folder(self.folder / recipe.stage)
        return self.folder / recipe.stage / recipe.key

    def _is_entry(self, entry_path: Path) -> bool:
        """Return True if the folder of an entry exists.

        Anything else at the path of the entry is removed.
        """
        if is_folder(entry_path):
            return True
        if os.path.lexists(entry_path):
            entry_path.unlink()
            emit(
                MACHINE_CACHE_UNUSABLE.warning(
                    "{place} was not a folder; it is removed, and the stage runs again.", place=entry_path
                )
            )
        return False

    def _iterate_entry_paths(self) -> Iterator[Path]:
        for stage in sorted(self.folder.iterdir()) if self.folder.is_dir() else ():
            if is_folder(stage) and stage.name not in (_DRAFTS, _RUNS):
                yield from sorted(path for path in stage.iterdir() if _KEY.fullmatch(path.name))

    def _list_entries(self, *, thorough: bool) -> list[ListedEntry]:
        used = self._find_used_keys()
        listed = []
        for entry_path in self._iterate_entry_paths():
            # Another process may remove an entry during the listing.
            with contextlib.suppress(FileNotFoundError):
                listed.append(_describe_entry(entry_path, entry_path.name in used, thorough=thorough))
        return listed

    def prepare(self) -> None:
        """Create the folder of the cache, with the file that marks it as one."""
        for name in (_DRAFTS, _RUNS):
            _check_folder(self.folder / name)
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError), (self.folder / "CACHEDIR.TAG").open("x") as tag:
            tag.write(_TAG)

    @contextlib.contextmanager
    def _lock_names(self) -> Iterator[None]:
        try:
            lock = take_lock(self.folder / "names.lock")
        except OSError as error:
            # In a read-only folder no process can move entries, so no lock is needed.
            if error.errno not in READ_ONLY_ERRORS:
                raise
            yield
            return
        try:
            yield
        finally:
            lock.release()

    def _create_draft(self, stage: str) -> tuple[Path, FileLock]:
        self.prepare()
        draft: Path | None = None
        lock: FileLock | None = None
        try:
            with self._lock_names():
                draft = self._create_draft_folder(stage)
                lock = take_lock(draft / IN_USE_LOCK)
            return draft, lock
        except BaseException:
            # Ctrl-C may arrive before the caller knows of the draft.
            if lock is not None:
                lock.release()
            if draft is not None:
                shutil.rmtree(draft, ignore_errors=True)
            raise

    def _create_draft_folder(self, stage: str) -> Path:
        folder = Path(tempfile.mkdtemp(prefix=f"{stage}-{get_host_id()}-", dir=self.folder / _DRAFTS))
        # mkdtemp creates the folder with mode 0700; entries get the mode of the cache folder.
        folder.chmod(self.folder.stat().st_mode & 0o777)
        return folder

    def _publish(self, draft: Path, entry_path: Path, lock: FileLock, replace: bool) -> FileLock | None:
        """Turn a draft into an entry and return a shared lock on it.

        Returns None if the entry exists already.
        """
        with self._lock_names():
            if self._is_entry(entry_path):
                if not replace:
                    return None
                self._move_to_drafts(entry_path)
            entry_path.parent.mkdir(exist_ok=True)
            # Windows cannot move a folder that contains an open file. Releasing is safe: no other process
            # locks entries or drafts while this one holds the names lock.
            lock.release()
            try:
                rename_atomically(draft, entry_path)
            except OSError as error:
                # Without locks between machines, another machine may have stored the entry first.
                if error.errno in (errno.ENOTEMPTY, errno.EEXIST) and not replace:
                    return None
                raise
            held = take_lock(entry_path / IN_USE_LOCK, shared=True)
        # Flush after the names lock is released, so that others need not wait for the disk; the files are
        # flushed already.
        try:
            flush(entry_path.parent)
        except BaseException:
            held.release()
            raise
        return held

    def _drop_damaged(self, entry_path: Path, lock: FileLock) -> bool:
        """Remove a damaged entry unless another process has done so; release `lock`."""
        with self._lock_names():
            is_ours = lock.matches_path(entry_path / IN_USE_LOCK)
            lock.release()
            if is_ours:
                self._move_to_drafts(entry_path)
        self.remove_abandoned()
        return is_ours

    def _move_to_drafts(self, entry_path: Path) -> None:
        # The entry disappears at once, but its files stay until the last reader releases its lock.
        rename_atomically(
            entry_path, self.folder / _DRAFTS / f"{entry_path.parent.name}-{secrets.token_hex(8)}"
        )

    def _remove(self, entry: ListedEntry) -> bool:
        entry_path = self.folder / entry.stage / entry.key
        with self._lock_names():
            if not self._is_entry(entry_path):
                return True
            lock = try_lock(entry_path / IN_USE_LOCK)
            if lock is None:
                return False
            lock.release()
            self._move_to_drafts(entry_path)
        return True

    def _get_record_path(self, out: Path) -> Path:
        return self.folder / _RUNS / f"{compute_digest(self._make_relative(out))[:16]}.json"

    def _make_relative(self, out: Path) -> str:
        # A relative path: an output folder that is moved together with its cache keeps its record.
        return get_relative_path(out, self.folder)

    def _find_used_keys(self) -> set[str]:
        used: set[str] = set()
        for path in (self.folder / _RUNS).glob("*.json"):
            record = _read_record(path)
            keys = record.get("keys")
            # Results of deleted output folders are not protected.
            if isinstance(keys, list) and (self.folder / str(record.get("out"))).is_dir():
                used.update(map(str, keys))
        return used


def _check_folder(path: Path) -> None:
    """Raise StageError if a path exists and is not a folder.

    A link is an error, too: it could point to other data.
    """
    if os.path.lexists(path) and not is_folder(path):
        raise StageError(
            MACHINE_CACHE_UNUSABLE,
            "a folder of the cache is expected here, but this is a link or a file",
            remedy="remove it, or move the cache to another folder (SCANLOOM_CACHE).",
            where=path,
        )


def _lock_folder(out: Path, on_wait: Callable[[], None]) -> FileLock:
    """Wait for exclusive use of an output folder.

    The folder itself is locked, for a read-only cache.
    """
    lock = try_folder_lock(out)
    if lock is None:
        on_wait()
        lock = take_folder_lock(out)
    return lock


def _discard(draft: Path, lock: FileLock) -> None:
    # Windows cannot remove a folder that contains an open file. Another process may remove the unlocked draft
    # first.
    lock.release()
    shutil.rmtree(draft, ignore_errors=True)


def _read_record(path: Path) -> dict[str, Any]:
    # Records only serve explanations and pruning, so an unreadable record is treated as missing.
    try:
        record = {} if path.is_symlink() else json.loads(read_input_text(path, "utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def _describe_entry(entry_path: Path, in_latest_run: bool, *, thorough: bool) -> ListedEntry:
    manifest: dict[str, Any] = {}
    problem = None
    try:
        manifest = (verify_entry if thorough else read_manifest)(entry_path)
    except DamagedEntryError as error:
        problem = str(error) if is_folder(entry_path) else "it is not a folder"
    sizes = (
        [path.lstat().st_size for path in entry_path.rglob("*") if path.is_file()]
        if is_folder(entry_path)
        else []
    )
    stamp = entry_path / IN_USE_LOCK
    last_used = datetime.fromtimestamp(
        (stamp if stamp.exists() else entry_path).lstat().st_mtime, timezone.utc
    )
    return ListedEntry(
        entry_path.parent.name, entry_path.name, sum(sizes), last_used, in_latest_run, manifest, problem
    )
