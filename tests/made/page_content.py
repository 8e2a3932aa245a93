"""Content of single-file pages."""

from __future__ import annotations

import json
import re
from typing import Any


def read_page_content(page: bytes) -> dict[str, Any]:
    """Parse the content that is embedded in a page."""
    found = re.search(rb'id="content"[^>]*>(.*?)</script>', page, re.DOTALL)
    assert found is not None
    content: dict[str, Any] = json.loads(found[1])
    return content
