"""Diagnostic codes of report files, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

REPORT_INCOMPLETE = Code(
    "report.incomplete",
    "Missing or modified files of a page",
    """
The page is made from the files in OUT. If files are missing or modified, run again: cached results are
only copied.
""",
    "out/photos/12.jpg: this photo is missing; run again.",
)
