"""What runs in a process of its own to read a cloud; see `scanloom.stages.files.own_process`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.files.own_process import answer
from scanloom.stages.surface.formats.cloud_parts import Parts
from scanloom.stages.surface.formats.e57 import read_e57
from scanloom.stages.surface.formats.las import read_las


def main() -> None:
    """Read a cloud's file into parts in a folder; the words are both."""
    answer(_read)


def _read(words: list[str]) -> dict[str, Any]:
    path, folder = map(Path, words)
    parts = Parts(folder, path)
    with collecting() as diagnostics:
        (read_e57 if path.suffix.lower() == ".e57" else read_las)(path, parts)
    return {**parts.told(), "diagnostics": [diagnostic.figures() for diagnostic in diagnostics]}
