"""What the stage `upright` leaves for those whose results stand."""

from __future__ import annotations

import json
from pathlib import Path

from stages.files.documents import read_document

# What is up, of length 1.
Up = tuple[float, float, float]

_FILE = "upright.json"


def write_up(folder: Path, up: Up | None) -> None:
    """Write what is up; None to turn nothing."""
    (folder / _FILE).write_text(json.dumps({"up": up}) + "\n", encoding="utf-8", newline="\n")


def read_up(folder: Path) -> Up | None:
    """Return what is up; None to turn nothing."""
    up = read_document(folder / _FILE)["up"]
    return None if up is None else (up[0], up[1], up[2])
