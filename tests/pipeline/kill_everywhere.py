"""Kill a process at every step it takes in the file system, and look at what it leaves.

`python kill_everywhere.py SCAN FOLDER EVERY` works on the toy pipeline and prints how many kills there were.
A child is forked for each; it kills itself when it is about to make its n-th call that touches a file. With
`windows` as fourth word the sources take this for Windows.
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


def contents(out: Path) -> list[bytes | None]:
    """The results in an output folder, None for those that are not there."""
    return [(out / name).read_bytes() if (out / name).exists() else None for name in RESULTS]


def killed_at(step: int, scan: Path, out: Path) -> bool:
    """Run with another parameter in a child that dies at its n-th step; return whether it got there."""
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


def check(scan: Path, out: Path, old: list[bytes], new: list[bytes]) -> None:
    """What a killed run may leave, and that the next one comes to the right result from there."""
    left = contents(out)
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
    assert contents(out) == new
    assert not list((out / "cache" / "drafts").iterdir()), "debris in the cache"
    assert not list(out.rglob("*.part")), "debris in the output folder"


def fsync(descriptor: int) -> None:  # noqa: ARG001
    """A step like the others, but quick: what a killed process has written is not lost with it."""
    sys.audit("fsync")


def main(scan: Path, folder: Path, every: int) -> None:
    os.fsync = fsync
    toy.run(scan, folder / "first")
    toy.run(scan, folder / "reference", "mix.gain=0.25")
    old, new = contents(folder / "first"), contents(folder / "reference")
    assert all(a != b for a, b in zip(old, new, strict=True))
    kills = 0
    while True:
        out = folder / "out"
        shutil.copytree(folder / "first", out)
        killed = killed_at(kills * every, scan, out)
        check(scan, out, old, new)
        shutil.rmtree(out)
        if not killed:
            break
        kills += 1
    print(kills)  # noqa: T201


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
