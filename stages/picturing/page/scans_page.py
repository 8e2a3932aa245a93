"""The page over the results of many scans, which stand in folders beside it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from stages.files.opening import content_of

_HERE = Path(__file__).parent


def scans_page(title: str, rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a page that lists scans; pictures are shown from their folders, and nothing else is asked for.

    Parameters
    ----------
    rows : for JSON: of each scan its `scan` (name), `state`, `reason`, `warnings` (sentences), and by name
        the folder of its results from the page on (`out`), the files in it (`picture`, `page`, `result`) and
        its figures; None for what there is not.
    """
    page = content_of(_HERE / "scans" / "index.html").decode()
    # In a script element only what looks like its end, or a comment's start, would be read as HTML.
    content = json.dumps({"title": title, "rows": rows}).replace("<", "\\u003c")
    return page.replace("CONTENT", content, 1).encode()
