"""Queue of a batch: a folder of plain files that several machines can share.

    OUT/queue/0001/
      jobs.jsonl     settings of the batch, then one line per job; written atomically, never changed
      claims/        claims of jobs by workers (`scanloom.pipeline.batch.claims`)
      done/          outcomes of jobs (`scanloom.pipeline.batch.job_records`)
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
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from scanloom.pipeline.batch.atomic_write import write_atomically_unlocked
from scanloom.pipeline.batch.codes import BATCH_QUEUE_DAMAGED
from scanloom.pipeline.batch.queue_validation import (
    find_job_problem,
    require_trusted_files,
    require_valid_settings,
)
from scanloom.pipeline.cache.digest import compute_digest
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.relative_paths import get_relative_path
from scanloom.stages import __version__
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import require_shallow
from scanloom.stages.files.input_files import read_input_text

QUEUE_FOLDER = "queue"
_JOBS_FILE = "jobs.jsonl"
_FORMAT_VERSION = 2
# Names in OUT that a scan must not use.
RESERVED_NAMES = frozenset({QUEUE_FOLDER, "cache", "index.html", "batch.csv", "batch.parquet", "batch.json"})
# Seconds to wait for another process to finish writing a queue, and seconds between two checks.
_WRITE_TIMEOUT, _POLL_INTERVAL = 10.0, 0.1
_SUBFOLDERS = ("claims", "done", "workers")
_MAX_JOBS = 1_000_000
# Maximum digits of the number of a queue.
_MAX_DIGITS = 9


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
class BatchSettings:
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
class BatchQueue:
    """Queue read from its folder.

    Attributes
    ----------
    out : output folder of the batch.
    folder : folder of the queue.
    damaged : numbers of the jobs whose lines are damaged or refused.
    refusals : reason of each refused job, by number.
    version : version of scanloom that wrote the queue.
    """

    out: Path
    folder: Path
    settings: BatchSettings
    jobs: tuple[Job, ...]
    damaged: tuple[int, ...]
    version: str
    refusals: Mapping[int, str] = field(default_factory=dict)

    @property
    def numbers(self) -> list[int]:
        """Numbers of all jobs, including damaged ones."""
        return [*range(len(self.jobs) + len(self.damaged))]

    def get_scan_path(self, job: Job) -> Path:
        """Return the path of the scan of a job."""
        return Path(os.path.normpath(self.out / job.scan))

    def get_output_folder(self, job: Job) -> Path:
        """Return the output folder of a job."""
        return self.out / job.name

    @property
    def cache(self) -> Path:
        """Folder of the shared cache."""
        return Path(os.path.normpath(self.out / self.settings.cache))

    def matches(self, settings: BatchSettings, jobs: Sequence[Job]) -> bool:
        """Return True if settings, jobs and version of the queue match."""
        return not self.damaged and (self.settings, self.jobs, self.version) == (
            settings,
            tuple(jobs),
            __version__,
        )


def make_jobs(scans: Sequence[tuple[Path, str]], out: Path) -> tuple[Job, ...]:
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
        name = f"{first}_{slash}{rest}" if first.casefold() in RESERVED_NAMES else name
        while name.casefold() in taken:
            name += "_"
        taken.add(name.casefold())
        jobs.append(Job(number, get_relative_path(place, out), name))
    return tuple(jobs)


def read_current_queue(out: Path) -> BatchQueue | None:
    """Read the current queue of an output folder; None if it has no queue.

    Raises
    ------
    InputError
        If the settings line is damaged.
    """
    folder = _find_current_folder(out)
    return None if folder is None else _read_queue(out, folder)


def find_latest_number(out: Path) -> int:
    """Return the highest queue number, complete or not; 0 without a queue."""
    return max(map(_parse_number, _list_queue_folders(out)), default=0)


def create_queue(out: Path, number: int, settings: BatchSettings, jobs: Sequence[Job]) -> BatchQueue | None:
    """Write a new queue and make it current; None if another process was faster.

    Parameters
    ----------
    number : highest existing queue number plus one.

    Raises
    ------
    StageError
        If the queue cannot be written.
    """
    with convert_os_errors(f"the queue in {out / QUEUE_FOLDER} cannot be written"):
        (out / QUEUE_FOLDER).mkdir(parents=True, exist_ok=True)
        require_trusted_files(out, [out / QUEUE_FOLDER])
        folder = out / QUEUE_FOLDER / f"{number:04d}"
        try:
            folder.mkdir()
        except FileExistsError:
            return None
        for name in _SUBFOLDERS:
            (folder / name).mkdir()
        head = {"schema": _FORMAT_VERSION, "scanloom": __version__, "jobs": len(jobs), **asdict(settings)}
        lines = [_format_line(head), *(_format_line(asdict(job)) for job in jobs)]
        write_atomically_unlocked(folder / _JOBS_FILE, "".join(lines).encode())
        for older in _list_queue_folders(out):
            if _parse_number(older) < number:
                shutil.rmtree(older, ignore_errors=True)
    return BatchQueue(out, folder, settings, tuple(jobs), (), __version__)


def _list_queue_folders(out: Path) -> list[Path]:
    folder = out / QUEUE_FOLDER
    found = folder.iterdir() if folder.is_dir() else ()
    numbered = (path for path in found if path.name.isascii() and path.name.isdigit())
    return sorted((path for path in numbered if len(path.name) <= _MAX_DIGITS), key=_parse_number)


def _parse_number(folder: Path) -> int:
    return int(folder.name)


def _find_current_folder(out: Path) -> Path | None:
    """Return the folder of the current queue.

    Waits for a queue that is being written.
    """
    end = time.monotonic() + _WRITE_TIMEOUT
    while True:
        found = _list_queue_folders(out)
        if not found:
            return None
        whole = [folder for folder in found if (folder / _JOBS_FILE).is_file()]
        if whole and whole[-1] == found[-1]:
            return whole[-1]
        if time.monotonic() > end:
            # The process that created the last folder was killed before it wrote the job list.
            return whole[-1] if whole else None
        time.sleep(_POLL_INTERVAL)


def _format_line(values: Mapping[str, Any]) -> str:
    # Convert tuples to lists first, so that the check digest matches the values read back.
    plain = json.loads(json.dumps(values))
    return json.dumps({**plain, "check": compute_digest(plain)[:16]}, ensure_ascii=False) + "\n"


def _read_queue(out: Path, folder: Path) -> BatchQueue:
    path = folder / _JOBS_FILE
    subfolders = [folder / name for name in _SUBFOLDERS]
    require_trusted_files(out, [out / QUEUE_FOLDER, folder, *subfolders, path])
    try:
        head, *rest = read_input_text(path, "utf-8").split("\n")
    except (OSError, UnicodeDecodeError):
        head, rest = "", []
    about = _parse_line(head)
    count = about.get("jobs") if about else None
    settings = _parse_settings(about, out, path) if about else None
    if about is None or settings is None or type(count) is not int or not 0 <= count <= _MAX_JOBS:
        raise InputError(
            BATCH_QUEUE_DAMAGED,
            "the queue is damaged, or was written by another version",
            path,
            remedy="run `scanloom batch` again: it rewrites the queue and keeps all results.",
        )
    jobs: dict[int, Job] = {}
    refusals: dict[int, str] = {}
    taken: set[str] = set()
    for values in map(_parse_line, rest):
        number = None if values is None else values.get("number")
        if values is None or type(number) is not int or not 0 <= number < count or number in jobs:
            continue
        scan, name = values.get("scan"), values.get("name")
        problem = find_job_problem(scan, name, out, RESERVED_NAMES)
        if problem is None and str(name).casefold() in taken:
            problem = f"its results {str(name)[:100]!r} are those of another job"
        if problem is not None:
            refusals[number] = problem
            continue
        taken.add(str(name).casefold())
        jobs[number] = Job(number, str(scan), str(name))
    damaged = tuple(number for number in range(count) if number not in jobs)
    kept = tuple(jobs[number] for number in range(count) if number in jobs)
    return BatchQueue(out, folder, settings, kept, damaged, str(about.get("scanloom"))[:40], refusals)


def _parse_line(line: str) -> dict[str, Any] | None:
    """Parse a line of the job list.

    Returns None if the check digest does not match.
    """
    try:
        values = json.loads(line)
        require_shallow(values)
        check = values.pop("check")
        return values if compute_digest(values)[:16] == check else None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None


def _parse_settings(about: Mapping[str, Any], out: Path, path: Path) -> BatchSettings | None:
    if about.get("schema") != _FORMAT_VERSION:
        return None
    try:
        known = {one.name: about[one.name] for one in fields(BatchSettings)}
    except KeyError:
        return None
    require_valid_settings(known, out, path)
    return BatchSettings(**{**known, "force": tuple(known["force"])})
