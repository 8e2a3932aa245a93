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

from scanloom.pipeline.cache.codes import MACHINE_CACHE_UNUSABLE
from scanloom.pipeline.cache.digest import digest
from scanloom.pipeline.cache.entry import IN_USE, DamagedError, Entry, Recipe, read_manifest, seal, verified
from scanloom.pipeline.cache.files import write_whole
from scanloom.pipeline.cache.locks import (
    READ_ONLY,
    Lock,
    is_folder,
    take_folder,
    take_lock,
    try_folder,
    try_lock,
)
from scanloom.pipeline.cache.machine_mark import is_of_another_machine, machine_mark
from scanloom.pipeline.cache.system import flush
from scanloom.pipeline.failures import explained
from scanloom.pipeline.own_paths import from_there
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.moving import move
from scanloom.stages.files.opening import text_in

_DRAFTS = "drafts"
_RUNS = "runs"
_KEY = re.compile("[0-9a-f]{64}")
_TAG = "Signature: 8a477f597d28d172789f06886806bc55\n# Results of scanloom; safe to delete.\n"


@dataclass(frozen=True)
class Listed:
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
        place = self._place(recipe)
        with explained(f"the cache folder {self.folder} cannot be used"):
            while os.path.lexists(place):
                with self._names():
                    if not self._is_entry(place):
                        break
                    lock = take_lock(place / IN_USE, shared=True)
                try:
                    manifest = verified(place)
                except DamagedError as error:
                    if self._drop(place, lock):
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
                return Entry(place, manifest, lock)
        return None

    def store(
        self, recipe: Recipe, make: Callable[[Path], Mapping[str, Any]], *, replace: bool = False
    ) -> Entry:
        """Compute and store an entry.

        Parameters
        ----------
        make : writes the files of the stage into a given empty folder and returns manifest fields: `figures`,
            and `made` with seconds and memory, which do not affect the result.
        replace : replace an existing entry. If False and another process stored the entry first, that entry
            is returned and the new files are discarded.

        Raises
        ------
        StageError
            If the disk is full or the folder is not writable; no partial entry is left.
        """
        with explained(f"the result of {recipe.stage} cannot be written to the cache {self.folder}"):
            draft, lock = self._new_draft(recipe.stage)
            try:
                seal(draft, recipe, make(draft))
                while (held := self._publish(draft, self._place(recipe), lock, replace)) is None:
                    winner = self.get(recipe)
                    if winner is not None:
                        _discard(draft, lock)
                        return winner
            except BaseException:
                _discard(draft, lock)
                raise
            if replace:
                self.remove_abandoned()
            return Entry(self._place(recipe), read_manifest(self._place(recipe)), held)

    def remove_abandoned(self, *, everywhere: bool = False) -> None:
        """Remove drafts of killed processes, and removed entries that were still being read.

        Parameters
        ----------
        everywhere : also remove drafts of other machines. Only safe if no other machine is using the cache,
            as the share may not support locks between machines.
        """
        with explained(f"the cache folder {self.folder} cannot be used"):
            drafts = self.folder / _DRAFTS
            for draft in drafts.iterdir() if is_folder(drafts) else ():
                # Locks may only hold within one machine, so drafts of other machines could be in use.
                if is_of_another_machine(draft.name) and not everywhere:
                    continue
                with self._names():
                    # A draft is created and locked under the names lock, so an unlocked draft is abandoned.
                    lock = try_lock(draft / IN_USE) if is_folder(draft) else None
                if lock is not None:
                    _discard(draft, lock)

    def ls(self) -> list[Listed]:
        """List all entries by stage, most recently used first, without verifying files."""
        listed = self._listed(thorough=False)
        return sorted(listed, key=lambda entry: (entry.stage, -entry.last_used.timestamp()))

    def verify(self) -> list[Listed]:
        """List all entries, reading every file to find damage; nothing is changed."""
        return self._listed(thorough=True)

    def prune(
        self,
        *,
        unused: bool = True,
        older_than: float | None = None,
        max_size: int | None = None,
        dry_run: bool = False,
        everywhere: bool = False,
    ) -> list[Listed]:
        """Remove entries and return them; entries in use by other processes are kept.

        Parameters
        ----------
        unused : remove entries that no output folder's latest run used.
        older_than : remove entries last used more than this many seconds ago.
        max_size : then remove the least recently used entries until the cache is at most this many bytes.
            Entries used by latest runs are kept.
        dry_run : only return the entries that would be removed.
        everywhere : see `remove_abandoned`.
        """
        entries = sorted(self.ls(), key=lambda entry: entry.last_used)
        now = datetime.now(timezone.utc)
        chosen: list[Listed] = []
        kept: list[Listed] = []
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
        with explained(f"the cache folder {self.folder} cannot be pruned"):
            removed = [entry for entry in chosen if self._remove(entry)]
        self.remove_abandoned(everywhere=everywhere)
        return removed

    def limit(self, max_size: int) -> None:
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

    def sole_run(self, out: Path, waiting: Callable[[], None]) -> Lock:
        """Wait for exclusive use of an output folder; release the returned lock afterwards.

        Parameters
        ----------
        waiting : called once if another run is using the folder.
        """
        with explained(f"the cache folder {self.folder} cannot be used"):
            path = self._run_record(out).with_suffix(".lock")
            try:
                self._prepare()
                lock = try_lock(path)
            except OSError as error:
                if error.errno not in READ_ONLY:
                    raise
                return _sole_folder(out, waiting)
            if lock is None:
                waiting()
                lock = take_lock(path)
            return lock

    def remember_run(self, out: Path, record: Mapping[str, Any]) -> None:
        """Record the latest run of an output folder; `record["keys"]` lists the used entries."""
        with explained(f"the cache folder {self.folder} cannot be used"):
            text = json.dumps({"out": self._seen_from_here(out), **record}, indent=1)
            try:
                self._prepare()
                write_whole(self._run_record(out), text.encode())
            except OSError as error:
                if error.errno not in READ_ONLY:
                    raise
                self._say_read_only()

    def latest_run(self, out: Path) -> dict[str, Any]:
        """Return the record of the latest run of an output folder; empty if missing."""
        return _read_record(self._run_record(out))

    def _say_read_only(self) -> None:
        if not self._is_read_only:
            self._is_read_only = True
            emit(
                MACHINE_CACHE_UNUSABLE.warning(
                    "the cache {folder} is read-only: its entries are used, but this run is not recorded.",
                    folder=self.folder,
                )
            )

    def _place(self, recipe: Recipe) -> Path:
        _require_folder(self.folder / recipe.stage)
        return self.folder / recipe.stage / recipe.key

    def _is_entry(self, place: Path) -> bool:
        """Return True if the folder of an entry exists.

        Anything else at the path of the entry is removed.
        """
        if is_folder(place):
            return True
        if os.path.lexists(place):
            place.unlink()
            emit(
                MACHINE_CACHE_UNUSABLE.warning(
                    "{place} was not a folder; it is removed, and the stage runs again.", place=place
                )
            )
        return False

    def _places(self) -> Iterator[Path]:
        for stage in sorted(self.folder.iterdir()) if self.folder.is_dir() else ():
            if is_folder(stage) and stage.name not in (_DRAFTS, _RUNS):
                yield from sorted(path for path in stage.iterdir() if _KEY.fullmatch(path.name))

    def _listed(self, *, thorough: bool) -> list[Listed]:
        used = self._used_by_latest_runs()
        listed = []
        for place in self._places():
            # Another process may remove an entry during the listing.
            with contextlib.suppress(FileNotFoundError):
                listed.append(_listed(place, place.name in used, thorough=thorough))
        return listed

    def _prepare(self) -> None:
        for name in (_DRAFTS, _RUNS):
            _require_folder(self.folder / name)
            (self.folder / name).mkdir(parents=True, exist_ok=True)
        with contextlib.suppress(FileExistsError), (self.folder / "CACHEDIR.TAG").open("x") as tag:
            tag.write(_TAG)

    @contextlib.contextmanager
    def _names(self) -> Iterator[None]:
        try:
            lock = take_lock(self.folder / "names.lock")
        except OSError as error:
            # In a read-only folder no process can move entries, so no lock is needed.
            if error.errno not in READ_ONLY:
                raise
            yield
            return
        try:
            yield
        finally:
            lock.release()

    def _new_draft(self, stage: str) -> tuple[Path, Lock]:
        self._prepare()
        draft: Path | None = None
        lock: Lock | None = None
        try:
            with self._names():
                draft = self._fresh_folder(stage)
                lock = take_lock(draft / IN_USE)
            return draft, lock
        except BaseException:
            # Ctrl-C may arrive before the caller knows of the draft.
            if lock is not None:
                lock.release()
            if draft is not None:
                shutil.rmtree(draft, ignore_errors=True)
            raise

    def _fresh_folder(self, stage: str) -> Path:
        folder = Path(tempfile.mkdtemp(prefix=f"{stage}-{machine_mark()}-", dir=self.folder / _DRAFTS))
        # mkdtemp creates the folder with mode 0700; entries get the mode of the cache folder.
        folder.chmod(self.folder.stat().st_mode & 0o777)
        return folder

    def _publish(self, draft: Path, place: Path, lock: Lock, replace: bool) -> Lock | None:
        """Turn a draft into an entry and return a shared lock on it.

        Returns None if the entry exists already.
        """
        with self._names():
            if self._is_entry(place):
                if not replace:
                    return None
                self._put_aside(place)
            place.parent.mkdir(exist_ok=True)
            # Windows cannot move a folder that contains an open file. Releasing is safe: no other process
            # locks entries or drafts while this one holds the names lock.
            lock.release()
            try:
                move(draft, place)
            except OSError as error:
                # Without locks between machines, another machine may have stored the entry first.
                if error.errno in (errno.ENOTEMPTY, errno.EEXIST) and not replace:
                    return None
                raise
            held = take_lock(place / IN_USE, shared=True)
        # Flush after the names lock is released, so that others need not wait for the disk; the files are
        # flushed already.
        try:
            flush(place.parent)
        except BaseException:
            held.release()
            raise
        return held

    def _drop(self, place: Path, lock: Lock) -> bool:
        """Remove a damaged entry unless another process has done so; release `lock`."""
        with self._names():
            ours = lock.is_of(place / IN_USE)
            lock.release()
            if ours:
                self._put_aside(place)
        self.remove_abandoned()
        return ours

    def _put_aside(self, place: Path) -> None:
        # The entry disappears at once, but its files stay until the last reader releases its lock.
        move(place, self.folder / _DRAFTS / f"{place.parent.name}-{secrets.token_hex(8)}")

    def _remove(self, entry: Listed) -> bool:
        place = self.folder / entry.stage / entry.key
        with self._names():
            if not self._is_entry(place):
                return True
            lock = try_lock(place / IN_USE)
            if lock is None:
                return False
            lock.release()
            self._put_aside(place)
        return True

    def _run_record(self, out: Path) -> Path:
        return self.folder / _RUNS / f"{digest(self._seen_from_here(out))[:16]}.json"

    def _seen_from_here(self, out: Path) -> str:
        # A relative path: an output folder that is moved together with its cache keeps its record.
        return from_there(out, self.folder)

    def _used_by_latest_runs(self) -> set[str]:
        used: set[str] = set()
        for path in (self.folder / _RUNS).glob("*.json"):
            record = _read_record(path)
            keys = record.get("keys")
            # Results of deleted output folders are not protected.
            if isinstance(keys, list) and (self.folder / str(record.get("out"))).is_dir():
                used.update(map(str, keys))
        return used


def _require_folder(path: Path) -> None:
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


def _sole_folder(out: Path, waiting: Callable[[], None]) -> Lock:
    """Wait for exclusive use of an output folder.

    The folder itself is locked, for a read-only cache.
    """
    lock = try_folder(out)
    if lock is None:
        waiting()
        lock = take_folder(out)
    return lock


def _discard(draft: Path, lock: Lock) -> None:
    # Windows cannot remove a folder that contains an open file. Another process may remove the unlocked draft
    # first.
    lock.release()
    shutil.rmtree(draft, ignore_errors=True)


def _read_record(path: Path) -> dict[str, Any]:
    # Records only serve explanations and pruning, so an unreadable record is treated as missing.
    try:
        record = {} if path.is_symlink() else json.loads(text_in(path, "utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def _listed(place: Path, in_latest_run: bool, *, thorough: bool) -> Listed:
    manifest: dict[str, Any] = {}
    problem = None
    try:
        manifest = (verified if thorough else read_manifest)(place)
    except DamagedError as error:
        problem = str(error) if is_folder(place) else "it is not a folder"
    sizes = [path.lstat().st_size for path in place.rglob("*") if path.is_file()] if is_folder(place) else []
    stamp = place / IN_USE
    last_used = datetime.fromtimestamp((stamp if stamp.exists() else place).lstat().st_mtime, timezone.utc)
    return Listed(place.parent.name, place.name, sum(sizes), last_used, in_latest_run, manifest, problem)
