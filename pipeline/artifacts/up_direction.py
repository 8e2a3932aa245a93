"""Up direction of a scan, for all results that are rotated upright."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from scanloom.pipeline.stage import Artifact
from scanloom.stages.files.documents import read_document

# Unit vector.
Up = tuple[float, float, float]

_FILE = "upright.json"


@dataclass(frozen=True)
class UpDirection(Artifact):
    """Up direction in a JSON file."""

    NAME = "up_direction"

    def load(self) -> Up | None:
        """Load the up direction; None means that results are not rotated."""
        up = read_document(self.folder / _FILE)["up"]
        return None if up is None else (up[0], up[1], up[2])


def write_up(folder: Path, up: Up | None) -> None:
    """Write the up direction; None means that results are not rotated."""
    (folder / _FILE).write_text(json.dumps({"up": up}) + "\n", encoding="utf-8", newline="\n")
