"""Job that hangs on opening a file, as on unresponsive network drives."""

from __future__ import annotations

import os
from pathlib import Path

# Source of a sitecustomize module, which every Python process runs at its start. It acts only in processes of
# jobs. The child process checks that ending a job also ends its children.
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
    """Make environment variables that let job processes hang when they open a file.

    A hanging process writes its process id and its child's id into `folder / "hung"`.

    Parameters
    ----------
    folder : for the module that makes processes hang.
    file : end of the path of the file.
    stage : during which opening hangs.
    cache : in which that stage stores its result.
    """
    folder.mkdir()
    hook = _HOOK.format(file=file, drafts=str(cache / "drafts"), stage=stage, marker=str(folder / "hung"))
    (folder / "sitecustomize.py").write_text(hook)
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)}


def is_any_alive(pid_file: Path) -> bool:
    """Check if any process listed in a file is alive."""
    return pid_file.exists() and any(map(_is_alive, pid_file.read_text().split()))


def _is_alive(process: str) -> bool:
    try:
        # State Z: a process that has ended but whose exit code was not collected.
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
