"""The process that runs cases, one a line of its input, with limits on its memory and on a case's time.

It answers on the standard output it was started with, at first that it is ready. What libraries print goes to
the standard error.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

from tests.campaign.fusion_cases import fusion_case
from tests.campaign.kernel_cases import kernel_case
from tests.campaign.reading import READERS
from tests.campaign.verdict import Verdict, judged

# What a case may take beyond the libraries that are loaded, bytes; each file is of some kilobytes.
_MEMORY = 3 << 30


def verdict_of(case: dict[str, Any]) -> Verdict:
    """Run a case: of a reader and the file it reads, or of kernels by its seed."""
    if case["kind"] == "readers":
        return judged(lambda: READERS[case["reader"]](Path(case["file"])))
    run = {"kernels": kernel_case, "fusion": fusion_case}[case["kind"]]
    return judged(lambda: run(case["seed"]))


def _limit_memory() -> None:
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    most = pages * resource.getpagesize() + _MEMORY
    resource.setrlimit(resource.RLIMIT_AS, (most, resource.getrlimit(resource.RLIMIT_AS)[1]))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main() -> None:
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    if Path("/proc/self/statm").exists():
        _limit_memory()
    answers.write("ready\n")
    answers.flush()
    for line in sys.stdin:
        case = json.loads(line)
        # Without a handler, the signal ends the process: nothing has to notice it.
        signal.setitimer(signal.ITIMER_PROF, case["seconds"])
        verdict = verdict_of(case)
        signal.setitimer(signal.ITIMER_PROF, 0)
        answers.write(json.dumps(verdict.to_dict()) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
