"""The page of a batch: a line for each scan, with its picture, figures, warnings and links."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from stages.picturing.page.scans_page import scans_page

PAGE = "index.html"


def page_of_batch(title: str, rows: Sequence[Mapping[str, Any]], warnings: Sequence[Sequence[str]]) -> bytes:
    """Return the page, which stands where the results' folders do.

    Parameters
    ----------
    rows : as `pipeline.batch.summary` has them.
    warnings : of each row, sentences.
    """
    return scans_page(title, [{**row, "warnings": list(of)} for row, of in zip(rows, warnings, strict=True)])
