"""Claims of jobs by workers: one file per attempt at a job.

`claims/000017.0` is the first attempt at job 17, `claims/000017.1` the second. Exclusive creation of a file
is atomic, on network shares too, so a job is claimed or taken over in one step. Claims are never deleted:
their number is the number of attempts.

A claim file has the name of the worker, one line per started stage, and the end of the attempt if it produced
no result: `released` if the worker was interrupted, `killed` or `crashed` if the job process was.
"""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.files.input_files import read_input_text

RELEASED, KILLED, CRASHED = "released", "killed", "crashed"
_STAGE_PREFIX = "at "
# A name that `create_worker_name` makes, and the name of a stage; other text in a claim is ignored.
_WORKER_NAME = re.compile(r"[A-Za-z0-9-]{1,80}")
_STAGE_NAME = re.compile(r"[A-Za-z0-9_ -]{1,40}")
_CLAIM_NAME = re.compile(r"(\d{6,7})\.(\d{1,4})", re.ASCII)
# Links and pipes in place of a claim are not followed.
_APPEND = (
    os.O_WRONLY
    | os.O_APPEND
    | sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_BINARY", "O_CLOEXEC"))
)
_EXCLUSIVE_CREATE = (
    os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)
)


@dataclass(frozen=True)
class Claim:
    """One attempt at a job.

    Attributes
    ----------
    number : job number.
    attempt : attempt number, from 0.
    """

    number: int
    attempt: int

    @property
    def successor(self) -> Claim:
        """Claim that takes over this job."""
        return Claim(self.number, self.attempt + 1)


@dataclass(frozen=True)
class ClaimContent:
    """Content of a claim file.

    Attributes
    ----------
    worker : name of the worker; "" if not written yet.
    stage : last started stage; "" if none.
    end : `released`, `killed` or `crashed`; None if the attempt is running or has a result.
    """

    worker: str
    stage: str
    end: str | None


class Claims:
    """Folder of claim files of a queue.

    Parameters
    ----------
    worker : name of the worker that makes claims.
    """

    def __init__(self, folder: Path, worker: str) -> None:
        self._folder = folder
        self._worker = worker

    def take(self, claim: Claim) -> bool:
        """Try to claim a job; return False if another worker was faster.

        Raises
        ------
        OSError
            If the folder cannot be written to.
        """
        path = self._get_path(claim)
        try:
            descriptor = os.open(path, _EXCLUSIVE_CREATE, 0o666)
        except FileExistsError:
            return False
        try:
            os.write(descriptor, f"{self._worker}\n".encode())
        except OSError:
            # A claim without a worker name (full disk) could not be attributed to anyone.
            path.unlink(missing_ok=True)
            raise
        finally:
            os.close(descriptor)
        return True

    def is_lost(self, claim: Claim) -> bool:
        """Return True if another worker has taken over the job of a claim."""
        return os.path.lexists(self._get_path(claim.successor))

    def record_stage(self, claim: Claim, stage: str) -> None:
        """Record in a claim that a stage started."""
        self._append(claim, f"{_STAGE_PREFIX}{stage}")

    def record_end(self, claim: Claim, ending: str) -> None:
        """Record in a claim that the attempt ended without a result."""
        self._append(claim, ending)

    def list_latest(self) -> dict[int, Claim]:
        """List the folder once and return the last attempt of each claimed job."""
        found: dict[int, Claim] = {}
        with os.scandir(self._folder) as names:
            for one in names:
                claim = parse_claim(one.name)
                if claim is not None and claim.attempt >= found.get(claim.number, claim).attempt:
                    found[claim.number] = claim
        return found

    def read_claim(self, claim: Claim) -> ClaimContent:
        """Read the content of a claim file; empty if it cannot be read."""
        try:
            lines = read_input_text(self._get_path(claim), "utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            lines = []
        worker, rest = (lines[0], lines[1:]) if lines and _WORKER_NAME.fullmatch(lines[0]) else ("", [])
        stages = [line.removeprefix(_STAGE_PREFIX) for line in rest if line.startswith(_STAGE_PREFIX)]
        ends = [line for line in rest if line in (RELEASED, KILLED, CRASHED)]
        stages = [stage for stage in stages if _STAGE_NAME.fullmatch(stage)]
        return ClaimContent(worker, stages[-1] if stages else "", ends[0] if ends else None)

    def read_attempts(self, claim: Claim) -> list[ClaimContent]:
        """Read all attempts of a job up to a claim, without released ones."""
        said = [self.read_claim(Claim(claim.number, attempt)) for attempt in range(claim.attempt + 1)]
        return [one for one in said if one.end != RELEASED]

    def _append(self, claim: Claim, line: str) -> None:
        descriptor = os.open(self._get_path(claim), _APPEND)
        try:
            os.write(descriptor, f"{line}\n".encode())
        finally:
            os.close(descriptor)

    def _get_path(self, claim: Claim) -> Path:
        return self._folder / f"{claim.number:06d}.{claim.attempt}"


def parse_claim(name: str) -> Claim | None:
    """Parse the name of a claim file; None for other names."""
    found = _CLAIM_NAME.fullmatch(name)
    return None if found is None else Claim(int(found[1]), int(found[2]))
