"""The queue of a batch: a folder of plain files that any number of machines may share.

    OUT/queue/0001/
      jobs.jsonl     the batch and a line for each job; written whole, then only read
      claims/        who works on what (`scanloom.pipeline.batch.claims`)
      done/          what became of each job (`scanloom.pipeline.batch.records`)
      workers/       signs of life (`scanloom.pipeline.batch.heartbeat`), and what workers said on stderr

The folder of the highest number holds the queue that stands; making the next one is the one step by which a
batch begins, and only one of several can make it. Nothing is locked, and no file's time is looked at.
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
# Names in OUT that are not a scan's.
RESERVED = frozenset({FOLDER, "cache", "index.html", "batch.csv", "batch.parquet", "batch.json"})
# Seconds until a queue that another process began to write is taken for one that it never will.
_PATIENCE, _PAUSE = 10.0, 0.1


@dataclass(frozen=True)
class Job:
    """One scan of a batch.

    Attributes
    ----------
    number : from 0, in order.
    scan : where it is, as written from OUT on, or a whole path where no way leads there.
    name : of its results below OUT, parts joined by /.
    """

    number: int
    scan: str
    name: str


@dataclass(frozen=True)
class Settings:
    """What is the same for all jobs of a batch; see `scanloom.pipeline.run.run.run`.

    Attributes
    ----------
    config : as TOML.
    cache : folder of the shared cache, as written from OUT on.
    take_over_after : seconds without a sign of life after which a worker is taken for dead.
    timeout : seconds after which a job that gets no further is ended; 0 for never.
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
    """A queue that stands.

    Attributes
    ----------
    damaged : numbers of the jobs whose lines cannot be read.
    version : of the scanloom that wrote it.
    """

    out: Path
    folder: Path
    settings: Settings
    jobs: tuple[Job, ...]
    damaged: tuple[int, ...]
    version: str

    @property
    def numbers(self) -> list[int]:
        """The numbers of all jobs, of damaged ones too."""
        return [*range(len(self.jobs) + len(self.damaged))]

    def scan_of(self, job: Job) -> Path:
        """Return where a job's scan is."""
        return Path(os.path.normpath(self.out / job.scan))

    def results_of(self, job: Job) -> Path:
        """Return the output folder of a job."""
        return self.out / job.name

    @property
    def cache(self) -> Path:
        """The folder of the shared cache."""
        return Path(os.path.normpath(self.out / self.settings.cache))

    def is_of(self, settings: Settings, jobs: Sequence[Job]) -> bool:
        """Return whether this is the queue of these jobs, by this version."""
        return not self.damaged and (self.settings, self.jobs, self.version) == (
            settings,
            tuple(jobs),
            __version__,
        )


def jobs_of(scans: Sequence[tuple[Path, str]], out: Path) -> tuple[Job, ...]:
    """Return the jobs of scans, each a place and a name; no two get results under one name.

    Upper and lower case alone do not tell names apart, for file systems that ignore it.
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
    """Return the queue of an output folder, or None if there is none.

    Raises
    ------
    InputError
        If its first line is damaged.
    """
    folder = _latest(out)
    return None if folder is None else _read(out, folder)


def latest_number(out: Path) -> int:
    """Return the number of the queue that was begun last, whole or not; 0 if none was."""
    return max(map(_number, _generations(out)), default=0)


def new_queue(out: Path, number: int, settings: Settings, jobs: Sequence[Job]) -> Queue | None:
    """Write a queue, which then stands; None if another process was faster.

    Parameters
    ----------
    number : one more than the latest that was seen: of those who have seen the same, one writes the next.

    Raises
    ------
    StageError
        If it cannot be written.
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
    """Return the folder of the queue that stands; one that is being written is waited for."""
    end = time.monotonic() + _PATIENCE
    while True:
        found = _generations(out)
        if not found:
            return None
        whole = [folder for folder in found if (folder / _JOBS).is_file()]
        if whole and whole[-1] == found[-1]:
            return whole[-1]
        if time.monotonic() > end:
            # Whoever made the last one was killed before it was written.
            return whole[-1] if whole else None
        time.sleep(_PAUSE)


def _line(values: Mapping[str, Any]) -> str:
    # As JSON has them, in which a row is a list.
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
            "the queue is damaged, or of another version",
            path,
            remedy="run scanloom batch again, which writes it anew and keeps all results.",
        )
    jobs = {job.number: job for line in rest if line and (job := _job(line)) is not None}
    damaged = tuple(number for number in range(count) if number not in jobs)
    kept = tuple(jobs[number] for number in range(count) if number in jobs)
    return Queue(out, folder, settings, kept, damaged, str(about.get("scanloom")))


def _values(line: str) -> dict[str, Any] | None:
    """Return what stands in a line, None if it is not as it was written."""
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
