"""Queue of a batch: a folder of plain files that several machines can share.

    OUT/queue/0001/
      jobs.jsonl     settings of the batch, then one line per job; written atomically, never changed
      claims/        claims of jobs by workers (`scanloom.pipeline.batch.claims`)
      done/          outcomes of jobs (`scanloom.pipeline.batch.records`)
      workers/       heartbeats (`scanloom.pipeline.batch.heartbeat`) and stderr logs of workers

The current queue is the folder with the highest number. Creating the next folder starts a batch, and is
atomic: only one of several processes succeeds. Neither locks nor file times are used, because network shares
may support neither.
"""

from __future__ import annotations

import json
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

from scanloom.pipeline.batch.codes import BATCH_QUEUE_DAMAGED
from scanloom.pipeline.batch.whole import write_whole
from scanloom.pipeline.cache.digest import digest
from scanloom.pipeline.failures import explained
from scanloom.pipeline.own_paths import from_there
from scanloom.stages import __version__
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import require_shallow
from scanloom.stages.files.inside import leads_inside
from scanloom.stages.files.opening import text_in

FOLDER = "queue"
_JOBS = "jobs.jsonl"
_FORMAT_VERSION = 1
# Names in OUT that a scan must not use.
RESERVED = frozenset({FOLDER, "cache", "index.html", "batch.csv", "batch.parquet", "batch.json"})
# Seconds to wait for another process to finish writing a queue, and seconds between two checks.
_PATIENCE, _PAUSE = 10.0, 0.1


@dataclass(frozen=True)
class Job:
    """One scan of a batch.

    Attributes
    ----------
    number : index in the batch, from 0.
    scan : path of the scan relative to OUT; absolute if on another drive.
    name : path of the results below OUT, with / separators.
    """

    number: int
    scan: str
    name: str


@dataclass(frozen=True)
class Settings:
    """Settings common to all jobs of a batch; see `scanloom.pipeline.run.run.run`.

    Attributes
    ----------
    config : configuration as TOML.
    cache : folder of the shared cache, relative to OUT.
    take_over_after : seconds without a heartbeat after which a worker is presumed dead.
    timeout : seconds without progress after which a job is ended; 0 for never.
    """

    config: str
    until: str | None = None
    force: tuple[str, ...] = ()
    overwrite: bool = False
    cache: str = "cache"
    take_over_after: float = 60.0
    timeout: float = 3600.0


@dataclass(frozen=True)
class Queue:
    """Queue read from its folder.

    Attributes
    ----------
    out : output folder of the batch.
    folder : folder of the queue.
    damaged : numbers of the jobs whose lines are damaged.
    version : version of scanloom that wrote the queue.
    """

    out: Path
    folder: Path
    settings: Settings
    jobs: tuple[Job, ...]
    damaged: tuple[int, ...]
    version: str

    @property
    def numbers(self) -> list[int]:
        """Numbers of all jobs, including damaged ones."""
        return [*range(len(self.jobs) + len(self.damaged))]

    def scan_of(self, job: Job) -> Path:
        """Return the path of the scan of a job."""
        return Path(os.path.normpath(self.out / job.scan))

    def results_of(self, job: Job) -> Path:
        """Return the output folder of a job."""
        return self.out / job.name

    @property
    def cache(self) -> Path:
        """Folder of the shared cache."""
        return Path(os.path.normpath(self.out / self.settings.cache))

    def is_of(self, settings: Settings, jobs: Sequence[Job]) -> bool:
        """Return True if settings, jobs and version of the queue match."""
        return not self.damaged and (self.settings, self.jobs, self.version) == (
            settings,
            tuple(jobs),
            __version__,
        )


def jobs_of(scans: Sequence[tuple[Path, str]], out: Path) -> tuple[Job, ...]:
    """Make the jobs of a batch, with unique result names.

    Names that differ only in upper and lower case are made unique, too, for case-insensitive file systems.

    Parameters
    ----------
    scans : path and name of each scan.
    out : output folder of the batch.
    """
    taken: set[str] = set()
    jobs = []
    for number, (place, name) in enumerate(scans):
        first, slash, rest = name.partition("/")
        name = f"{first}_{slash}{rest}" if first.casefold() in RESERVED else name
        while name.casefold() in taken:
            name += "_"
        taken.add(name.casefold())
        jobs.append(Job(number, from_there(place, out), name))
    return tuple(jobs)


def standing_queue(out: Path) -> Queue | None:
    """Read the current queue of an output folder; None if it has no queue.

    Raises
    ------
    InputError
        If the settings line is damaged.
    """
    folder = _latest(out)
    return None if folder is None else _read(out, folder)


def latest_number(out: Path) -> int:
    """Return the highest queue number, complete or not; 0 without a queue."""
    return max(map(_number, _generations(out)), default=0)


def new_queue(out: Path, number: int, settings: Settings, jobs: Sequence[Job]) -> Queue | None:
    """Write a new queue and make it current; None if another process was faster.

    Parameters
    ----------
    number : highest existing queue number plus one.

    Raises
    ------
    StageError
        If the queue cannot be written.
    """
    with explained(f"the queue in {out / FOLDER} cannot be written"):
        (out / FOLDER).mkdir(parents=True, exist_ok=True)
        folder = out / FOLDER / f"{number:04d}"
        try:
            folder.mkdir()
        except FileExistsError:
            return None
        for name in ("claims", "done", "workers"):
            (folder / name).mkdir()
        head = {"schema": _FORMAT_VERSION, "scanloom": __version__, "jobs": len(jobs), **asdict(settings)}
        lines = [_line(head), *(_line(asdict(job)) for job in jobs)]
        write_whole(folder / _JOBS, "".join(lines).encode())
        for older in _generations(out):
            if _number(older) < number:
                shutil.rmtree(older, ignore_errors=True)
    return Queue(out, folder, settings, tuple(jobs), (), __version__)


def _generations(out: Path) -> list[Path]:
    folder = out / FOLDER
    found = folder.iterdir() if folder.is_dir() else ()
    return sorted((path for path in found if path.name.isascii() and path.name.isdigit()), key=_number)


def _number(folder: Path) -> int:
    return int(folder.name)


def _latest(out: Path) -> Path | None:
    """Return the folder of the current queue.

    A queue that is being written is waited for.
    """
    end = time.monotonic() + _PATIENCE
    while True:
        found = _generations(out)
        if not found:
            return None
        whole = [folder for folder in found if (folder / _JOBS).is_file()]
        if whole and whole[-1] == found[-1]:
            return whole[-1]
        if time.monotonic() > end:
            # The process that created the last folder was killed before it wrote the job list.
            return whole[-1] if whole else None
        time.sleep(_PAUSE)


def _line(values: Mapping[str, Any]) -> str:
    # Convert tuples to lists first, so that the check digest matches the values read back.
    plain = json.loads(json.dumps(values))
    return json.dumps({**plain, "check": digest(plain)[:16]}, ensure_ascii=False) + "\n"


def _read(out: Path, folder: Path) -> Queue:
    path = folder / _JOBS
    try:
        head, *rest = text_in(path, "utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        head, rest = "", []
    about = _values(head)
    count = about.get("jobs") if about else None
    settings = _settings(about) if about else None
    if about is None or settings is None or not isinstance(count, int):
        raise InputError(
            BATCH_QUEUE_DAMAGED,
            "the queue is damaged, or was written by another version",
            path,
            remedy="run `scanloom batch` again: it rewrites the queue and keeps all results.",
        )
    jobs = {job.number: job for line in rest if line and (job := _job(line)) is not None}
    damaged = tuple(number for number in range(count) if number not in jobs)
    kept = tuple(jobs[number] for number in range(count) if number in jobs)
    return Queue(out, folder, settings, kept, damaged, str(about.get("scanloom")))


def _values(line: str) -> dict[str, Any] | None:
    """Parse a line of the job list.

    Returns None if the check digest does not match.
    """
    try:
        values = json.loads(line)
        require_shallow(values)
        check = values.pop("check")
        return values if digest(values)[:16] == check else None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def _settings(about: Mapping[str, Any]) -> Settings | None:
    if about.get("schema") != _FORMAT_VERSION:
        return None
    try:
        known = {one.name: about[one.name] for one in fields(Settings)}
    except KeyError:
        return None
    return Settings(**{**known, "force": tuple(known["force"])})


def _job(line: str) -> Job | None:
    values = _values(line)
    try:
        job = None if values is None else Job(int(values["number"]), str(values["scan"]), str(values["name"]))
    except (LookupError, ValueError, TypeError):
        return None
    return job if job is not None and leads_inside(job.name) else None
