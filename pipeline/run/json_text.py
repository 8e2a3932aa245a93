"""The text of report.json."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any


def to_json(report: Mapping[str, Any]) -> str:
    """Return a report as text for programs and for people."""
    return json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
