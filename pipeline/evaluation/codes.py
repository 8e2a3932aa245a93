"""Diagnostic codes of report files, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

REPORT_INCOMPLETE = Code(
    "report.incomplete",
    "The page of a run",
    """
The page is made of the files in OUT. If something there is missing or changed, run again: cached results
are only copied.
""",
    "out/photos/12.jpg: this photo is missing; run once more.",
)
