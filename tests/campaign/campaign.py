"""Loop of the campaign: cases of each kind in turn until the time is over, counts, and stored failures."""

from __future__ import annotations

import itertools
import shutil
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from tests.campaign import kept
from tests.campaign.judge import Judge
from tests.campaign.reader_cases import make_reader_case, write_files
from tests.campaign.run_cases import UndisturbedRun, prepare_run, run_case
from tests.campaign.specimens import write_all
from tests.campaign.verdict import FAILED, Verdict

KINDS = ("readers", "runs", "kernels", "fusion")
# Cases in a row before the next kind, so that no kind takes the time of the others.
_TURN = {"readers": 100, "runs": 1, "kernels": 10, "fusion": 10}

Counts = dict[str, Counter[str]]


class Campaign:
    """Resources of cases: a working folder, a child process, and an undisturbed run for comparison."""

    def __init__(self, failures: Path) -> None:
        self._failures = failures
        self._stack = ExitStack()
        self._bench: UndisturbedRun | None = None

    def __enter__(self) -> Campaign:
        made = tempfile.TemporaryDirectory(prefix="campaign-", ignore_cleanup_errors=True)
        self._folder = Path(self._stack.enter_context(made))
        self._judge = self._stack.enter_context(Judge())
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def run(self, kind: str, seed: int) -> tuple[Verdict, Path | None]:
        """Run the case of a seed; return its verdict, and the file of a failure."""
        files: dict[str, bytes] = {}
        case: dict[str, Any] = {"kind": kind, "seed": seed}
        if kind == "readers":
            case, files = make_reader_case(seed, self._write_specimens())
        place = self._make_folder()
        write_files(files, place)
        verdict = self._judge_case(case, place)
        shutil.rmtree(place, ignore_errors=True)
        if verdict.outcome == FAILED:
            return verdict, kept.store(self._failures, case, verdict, files)
        return verdict, None

    def repeat(self, file: Path) -> Verdict:
        """Repeat a stored failure."""
        place = self._make_folder()
        return self._judge_case(kept.load(file, place), place)

    def _judge_case(self, case: dict[str, Any], place: Path) -> Verdict:
        if case["kind"] == "runs":
            if self._bench is None:
                self._bench = prepare_run(self._folder / "bench")
            return run_case(case["seed"], self._bench, place)
        asked = {key: case[key] for key in ("kind", "seed")}
        if case["kind"] == "readers":
            asked |= {"reader": case["reader"], "file": str(place / case["target"])}
        return self._judge.judge(asked)

    def _write_specimens(self) -> Path:
        folder = self._folder / "specimens"
        if not folder.exists():
            write_all(folder)
        return folder

    def _make_folder(self) -> Path:
        return Path(tempfile.mkdtemp(prefix="case-", dir=self._folder))


def run_campaign(
    failures: Path,
    seed: int,
    kinds: Sequence[str],
    say: Callable[[str], None],
    *,
    minutes: float | None = None,
    cases: int | None = None,
) -> Counts:
    """Run cases for some minutes, or a number of each kind; return the counts by kind.

    Seeds count up from `seed` for each kind: the same seed gives the same cases.
    """
    counts: Counts = {kind: Counter() for kind in kinds}
    ends = float("inf") if minutes is None else time.monotonic() + 60 * minutes
    most = float("inf") if cases is None else cases
    seeds = {kind: itertools.count(seed) for kind in kinds}
    with Campaign(failures) as campaign:
        while time.monotonic() < ends and any(count.total() < most for count in counts.values()):
            for kind in kinds:
                for _ in range(_TURN[kind]):
                    if time.monotonic() >= ends or counts[kind].total() >= most:
                        break
                    verdict, file = campaign.run(kind, next(seeds[kind]))
                    counts[kind][verdict.outcome] += 1
                    if file is not None:
                        last = verdict.message.strip().splitlines()[-1][:200]
                        say(f"{kind}: {last}\n  repeat it with --again {file}")
    return counts
