"""Subprocess that reads a LAS, LAZ or E57 file; started by `scanloom.stages.files.own_process`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.files.own_process import answer
from scanloom.stages.surface.formats.cloud_parts import Parts
from scanloom.stages.surface.formats.e57 import read_e57
from scanloom.stages.surface.formats.las import read_las


def main() -> None:
    """Run the reader process.

    Arguments: the cloud file, and the folder of the chunk files.
    """
    answer(_read)


def _read(words: list[str]) -> dict[str, Any]:
    path, folder = map(Path, words)
    parts = Parts(folder, path)
    with collecting() as diagnostics:
        (read_e57 if path.suffix.lower() == ".e57" else read_las)(path, parts)
    return {**parts.told(), "diagnostics": [diagnostic.figures() for diagnostic in diagnostics]}
