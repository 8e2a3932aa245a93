"""What is odd about files, told where they are read; whoever reads the scan hands it on as warnings."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path

_TOLD: ContextVar[list[tuple[str, Path]] | None] = ContextVar("told", default=None)


@contextmanager
def telling() -> Iterator[list[tuple[str, Path]]]:
    """Collect what is told in the block, by the thread that runs it: sentences, each with its file."""
    told: list[tuple[str, Path]] = []
    before = _TOLD.set(told)
    try:
        yield told
    finally:
        _TOLD.reset(before)


def tell(said: str, path: Path) -> None:
    """Say something of a file, in a sentence that goes on after its name: `x.json` + ` is for …`."""
    told = _TOLD.get()
    if told is not None:
        told.append((said, path))


def in_sentences(told: Sequence[tuple[str, Path]]) -> list[str]:
    """Return what was told, once, with the name of the first file that it is said of."""
    files: dict[str, list[Path]] = {}
    for said, path in told:
        if path not in files.setdefault(said, []):
            files[said].append(path)
    return [
        f"{paths[0].name}{f' (and {len(paths) - 1} more files)' if len(paths) > 1 else ''} {said}"
        for said, paths in files.items()
    ]
