"""Subprocess that reads a LAS, LAZ or E57 file; started by `scanloom.stages.files.subprocess_reader`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.files.subprocess_reader import serve_request
from scanloom.stages.surface.formats.cloud_chunks import CloudChunkWriter
from scanloom.stages.surface.formats.e57 import read_e57
from scanloom.stages.surface.formats.las import read_las


def main() -> None:
    """Run the reader process.

    Arguments: the cloud file, and the folder of the chunk files.
    """
    serve_request(_read_cloud_file)


def _read_cloud_file(arguments: list[str]) -> dict[str, Any]:
    path, folder = map(Path, arguments)
    writer = CloudChunkWriter(folder, path)
    with collecting() as diagnostics:
        (read_e57 if path.suffix.lower() == ".e57" else read_las)(path, writer)
    return {**writer.get_metadata(), "diagnostics": [diagnostic.to_dict() for diagnostic in diagnostics]}
