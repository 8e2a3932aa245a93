"""Kill a process at every step of file access, and check the files that it leaves.

`python kill_everywhere.py SCAN FOLDER EVERY` runs on the toy pipeline and prints the number of kills. For
each kill a child is forked; it kills itself just before its n-th call that touches a file. With the fourth
word `windows`, Windows is emulated.
"""

import os
import shutil
import signal
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).parent), str(Path(__file__).parents[1] / "made")]

fork = os.fork
if sys.argv[4:] == ["windows"]:
    from pretend_windows import pretend

    pretend()

import toy  # noqa: E402

from scanloom.pipeline.cache.store import Cache  # noqa: E402

RESULTS = ("mixed.bin", "cut.bin", "tables/counts.txt")
WATCHED = {
    "open",
    "os.rename",
    "os.remove",
    "os.rmdir",
    "os.mkdir",
    "os.chmod",
    "os.utime",
    "fcntl.flock",
    "fsync",
}


def read_contents(out: Path) -> list[bytes | None]:
    """Read the results in an output folder, None for missing ones."""
    return [(out / name).read_bytes() if (out / name).exists() else None for name in RESULTS]


def run_and_kill(step: int, scan: Path, out: Path) -> bool:
    """Run with another parameter in a child that dies at its n-th step; return False if it ended earlier."""
    child = fork()
    if child == 0:
        left = step

        def count(event: str, _: object) -> None:
            nonlocal left
            if event in WATCHED:
                left -= 1
                if left < 0:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(count)
        toy.run(scan, out, "mix.gain=0.25")
        os._exit(0)
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.WEXITSTATUS(status) == 0
    return os.WIFSIGNALED(status)


def check_killed_run(scan: Path, out: Path, old: list[bytes], new: list[bytes]) -> None:
    """Check the files of a killed run, and that the next run gives the right result."""
    left = read_contents(out)
    present = {
        "old" if now == before else "new" if now == after else "broken"
        for now, before, after in zip(left, old, new, strict=True)
        if now is not None
    }
    assert len(present) <= 1, f"files of different runs: {present}"
    assert "broken" not in present, "a half-written result"
    problems = [entry.problem for entry in Cache(out / "cache").verify()]
    assert problems == [None] * len(problems), "an entry that is not whole"

    warnings: list[str] = []
    toy.run(scan, out, "mix.gain=0.25", warnings=warnings)
    assert warnings == []
    assert read_contents(out) == new
    assert not list((out / "cache" / "drafts").iterdir()), "debris in the cache"
    assert not list(out.rglob("*.part")), "debris in the output folder"


def fsync(descriptor: int) -> None:  # noqa: ARG001
    """Count as a step, but without the slow flush: data written by a killed process is not lost."""
    sys.audit("fsync")


def main(scan: Path, folder: Path, every: int) -> None:
    os.fsync = fsync
    toy.run(scan, folder / "first")
    toy.run(scan, folder / "reference", "mix.gain=0.25")
    old, new = read_contents(folder / "first"), read_contents(folder / "reference")
    assert all(a != b for a, b in zip(old, new, strict=True))
    kills = 0
    while True:
        out = folder / "out"
        shutil.copytree(folder / "first", out)
        killed = run_and_kill(kills * every, scan, out)
        check_killed_run(scan, out, old, new)
        shutil.rmtree(out)
        if not killed:
            break
        kills += 1
    print(kills)  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
