"""Child process that runs cases, one per input line, with limits on memory and processor time.

The first answer is that the process is ready. Answers go to the original standard output; output of libraries
goes to standard error.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
from pathlib import Path
from typing import Any

from tests.campaign.fusion_cases import run_fusion_case
from tests.campaign.kernel_cases import run_kernel_case
from tests.campaign.reading import READERS
from tests.campaign.verdict import Verdict, judge

# Memory of a case in addition to the loaded libraries, bytes; each file has some kilobytes.
_MEMORY = 3 << 30


def run_case(case: dict[str, Any]) -> Verdict:
    """Run a case: a reader with its file, or kernels with a seed."""
    if case["kind"] == "readers":
        return judge(lambda: READERS[case["reader"]](Path(case["file"])))
    run = {"kernels": run_kernel_case, "fusion": run_fusion_case}[case["kind"]]
    return judge(lambda: run(case["seed"]))


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
        # Without a handler, the signal ends the process, even inside a library.
        signal.setitimer(signal.ITIMER_PROF, case["seconds"])
        verdict = run_case(case)
        signal.setitimer(signal.ITIMER_PROF, 0)
        answers.write(json.dumps(verdict.to_dict()) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
