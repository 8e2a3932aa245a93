"""Diagnostic codes of runs, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

BATCH_LIMIT_EXCEEDED = Code(
    "batch.limit-exceeded",
    "More than a run may take",
    """
Exit code 1, of `run --memory` and `--disk`, too. Nothing is changed without being asked: set what the
sentence names,
or give more. What a stage is expected to take is an estimate until something like it was run with this cache.
""",
    ("fuse has taken 900 MB of memory, more than the limit of 600 MB; fuse.voxel_factor=1.5 would fit."),
)
REPORT_NO_RUN = Code(
    "report.no-run",
    "A folder without the results of a run",
    """
`coverage` continues a run: it needs the output folder of `scanloom run`, its cache, and the scan. Name a
cache elsewhere with `--cache`, and a scan that was moved with `--scan`.
""",
    "my_mesh: no run has left its results here; give the OUT of `scanloom run`.",
)
