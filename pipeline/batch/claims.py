"""Who works on what: a file for each try at a job, made by whoever then has the job.

`claims/000017.0` is the first try at job 17, `claims/000017.1` the second. A file that must not be there yet
can be made by one process only, over a shared folder too, so a job is taken, and taken over, in one step. No
claim is ever removed: how many there are tells how often a job was begun.

A claim holds the name of its worker, then a line for each stage that was begun, and how it ended if not by a
result: released where the worker was interrupted, killed or crashed where the process that ran the job was.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.files.opening import text_in

RELEASED, KILLED, CRASHED = "released", "killed", "crashed"
_AT = "at "
_FLAGS = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_BINARY", 0) | getattr(os, "O_CLOEXEC", 0)


@dataclass(frozen=True)
class Claim:
    """One try at a job.

    Attributes
    ----------
    number : of the job.
    attempt : from 0.
    """

    number: int
    attempt: int

    @property
    def next(self) -> Claim:
        """The try that takes over."""
        return Claim(self.number, self.attempt + 1)


@dataclass(frozen=True)
class Said:
    """What stands in a claim.

    Attributes
    ----------
    worker : "" if it is not written yet.
    stage : that was begun last; "" if none was.
    end : how it ended without a result, if it did.
    """

    worker: str
    stage: str
    end: str | None


class Claims:
    """The folder of claims of a queue.

    Parameters
    ----------
    worker : the name of this one.
    """

    def __init__(self, folder: Path, worker: str) -> None:
        self._folder = folder
        self._worker = worker

    def take(self, claim: Claim) -> bool:
        """Make a claim, and return whether it is ours: another may have been faster.

        Raises
        ------
        OSError
            If nothing can be written there.
        """
        path = self._path(claim)
        try:
            descriptor = os.open(path, _FLAGS, 0o666)
        except FileExistsError:
            return False
        try:
            os.write(descriptor, f"{self._worker}\n".encode())
        except OSError:
            # On a full disk nobody would know whose it is.
            path.unlink(missing_ok=True)
            raise
        finally:
            os.close(descriptor)
        return True

    def is_lost(self, claim: Claim) -> bool:
        """Return whether another worker has taken over what is ours by this claim."""
        return os.path.lexists(self._path(claim.next))

    def at(self, claim: Claim, stage: str) -> None:
        """Note in a claim of ours which stage is begun."""
        self._append(claim, f"{_AT}{stage}")

    def end(self, claim: Claim, how: str) -> None:
        """Note in a claim of ours that it ended without a result."""
        self._append(claim, how)

    def latest(self) -> dict[int, Claim]:
        """Return the last try at each job that has any; the folder is listed once."""
        found: dict[int, Claim] = {}
        with os.scandir(self._folder) as names:
            for one in names:
                claim = _claim(one.name)
                if claim is not None and claim.attempt >= found.get(claim.number, claim).attempt:
                    found[claim.number] = claim
        return found

    def said(self, claim: Claim) -> Said:
        """Return what stands in a claim."""
        try:
            lines = text_in(self._path(claim), "utf-8").splitlines()
        except (OSError, UnicodeDecodeError):
            lines = []
        worker, rest = (lines[0], lines[1:]) if lines else ("", [])
        stages = [line.removeprefix(_AT) for line in rest if line.startswith(_AT)]
        ends = [line for line in rest if line in (RELEASED, KILLED, CRASHED)]
        return Said(worker, stages[-1] if stages else "", ends[0] if ends else None)

    def tries(self, claim: Claim) -> list[Said]:
        """Return what stands in the claims of a job up to this one, but for those that were released."""
        said = [self.said(Claim(claim.number, attempt)) for attempt in range(claim.attempt + 1)]
        return [one for one in said if one.end != RELEASED]

    def _append(self, claim: Claim, line: str) -> None:
        with self._path(claim).open("a", encoding="utf-8", newline="\n") as file:
            file.write(f"{line}\n")

    def _path(self, claim: Claim) -> Path:
        return self._folder / f"{claim.number:06d}.{claim.attempt}"


def _claim(name: str) -> Claim | None:
    number, _, attempt = name.partition(".")
    is_claim = all(part.isascii() and part.isdigit() for part in (number, attempt))
    return Claim(int(number), int(attempt)) if is_claim else None
