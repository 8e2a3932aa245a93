"""Failures on disk: one JSON file each, with the damaged files in it, that is enough to repeat the case."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from typing import Any

from tests.campaign.verdict import Verdict


def keep(folder: Path, case: dict[str, Any], verdict: Verdict, files: dict[str, bytes]) -> Path:
    """Write a failure, with the files it reads by their names, and return its file."""
    folder.mkdir(parents=True, exist_ok=True)
    held = {name: base64.b64encode(content).decode() for name, content in files.items()}
    text = json.dumps({**case, "said": verdict.said, "files": held}, indent=1)
    digest = hashlib.sha256(text.encode()).hexdigest()[:8]
    path = folder / f"{case['kind']}-{case['seed']}-{digest}.json"
    path.write_text(text, encoding="utf-8")
    return path


def load(path: Path, folder: Path) -> dict[str, Any]:
    """Return the case of a failure; the files it reads are written into a folder."""
    case: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    for name, content in case.pop("files").items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(base64.b64decode(content))
    return case
