"""Stored failures: one JSON file each, with the damaged files, sufficient to repeat the case."""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path
from typing import Any

from tests.campaign.verdict import Verdict


def store(folder: Path, case: dict[str, Any], verdict: Verdict, files: dict[str, bytes]) -> Path:
    """Write a failure with the files of its case, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    held = {name: base64.b64encode(content).decode() for name, content in files.items()}
    text = json.dumps({**case, "message": verdict.message, "files": held}, indent=1)
    digest = hashlib.sha256(text.encode()).hexdigest()[:8]
    path = folder / f"{case['kind']}-{case['seed']}-{digest}.json"
    path.write_text(text, encoding="utf-8")
    return path


def load(path: Path, folder: Path) -> dict[str, Any]:
    """Read the case of a failure, and write its files into a folder."""
    case: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    for name, content in case.pop("files").items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(base64.b64decode(content))
    return case
