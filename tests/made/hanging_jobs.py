"""Job that hangs on opening a file, as on unresponsive network drives."""

from __future__ import annotations

import os
from pathlib import Path

# What Python runs at its start; only the processes of jobs are meant. The child is there to be ended, too.
_HOOK = """
import os, subprocess, sys, time
from pathlib import Path

draft = None


def hang(event, args):
    global draft
    # Jobs share a cache: what others draft there does not count.
    if event == "os.mkdir" and Path(str(args[0])).match({drafts!r} + "/" + {stage!r} + "-*"):
        draft = str(args[0])
    if event == "open" and str(args[0]).endswith({file!r}) and draft and os.path.isdir(draft):
        child = subprocess.Popen(["sleep", "1000"])
        Path({marker!r}).write_text(f"{{os.getpid()}} {{child.pid}}")
        time.sleep(1000)


if any("scanloom.pipeline.batch.job_process" in word for word in sys.orig_argv):
    sys.addaudithook(hang)
"""


def make_hanging_environment(folder: Path, file: str, stage: str, cache: Path) -> dict[str, str]:
    """Return variables with which the processes of jobs hang where they open a file.

    They then write their number, and that of a child, into `folder / "hung"`.

    Parameters
    ----------
    folder : gets what makes them hang.
    file : the end of its path.
    stage : that is at work then.
    cache : in which that stage makes its result.
    """
    folder.mkdir()
    hook = _HOOK.format(file=file, drafts=str(cache / "drafts"), stage=stage, marker=str(folder / "hung"))
    (folder / "sitecustomize.py").write_text(hook)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)}


def is_any_alive(pid_file: Path) -> bool:
    """Return whether any of the processes is there that have noted themselves."""
    return pid_file.exists() and any(map(_is_alive, pid_file.read_text().split()))


def _is_alive(process: str) -> bool:
    try:
        # One that has ended, and that nobody asks for how, is Z.
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
