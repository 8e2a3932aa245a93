"""Diagnostic codes of pages, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

REPORT_REDUCED = Code(
    "report.reduced",
    "Reduced or oversized page",
    """
A warning. Photos are omitted and models are simplified until the page fits `report.page_size`. Increase
it to keep more; the full result is in separate files.
""",
    "40 photos are omitted to keep the page below 20,000,000 bytes.",
)
MACHINE_PORT_TAKEN = Code(
    "machine.port-taken",
    "Port in use",
    """
`scanloom view` listens on 127.0.0.1. Without `--port` it chooses a free port.
""",
    "cannot listen on port 8080: Address already in use.",
)
