"""Diagnostic codes of pages, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

REPORT_REDUCED = Code(
    "report.reduced",
    "A page that is larger than asked, or without some photos",
    """
A warning. Photos and triangles are left out until the page fits `report.page_size`. A larger size keeps
more; the complete result is a file of its own.
""",
    "40 of the photos are left out of the page, which may take 20,000,000 bytes.",
)
MACHINE_PORT_TAKEN = Code(
    "machine.port-taken",
    "A port that is taken",
    """
`scanloom view` listens on 127.0.0.1; without `--port` it takes any that is free.
""",
    "port 8080 cannot be listened on: Address already in use.",
)
