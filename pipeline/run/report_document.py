"""Content of report.json."""

from __future__ import annotations

import platform
from collections.abc import Mapping, Sequence
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from scanloom.pipeline.graph import find_stage
from scanloom.pipeline.run.engine import StageOutcome
from scanloom.pipeline.run.schema import SCHEMA
from scanloom.stages import __version__
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.scans.model.scan import Scan

_LIBRARIES = ("numpy", "open3d", "opencv", "scipy", "scikit-image")


def compose_report(
    scan: Scan,
    diagnostics: Sequence[Diagnostic],
    outcomes: Sequence[StageOutcome],
    final: Mapping[str, Any],
    out: Path,
) -> dict[str, Any]:
    """Compose the content of report.json.

    Parameters
    ----------
    diagnostics : diagnostics of the scan and of the parameters.
    outcomes : outcomes of the stages of this run.
    final : metrics of the report stage; empty if the run ended before it.
    out : output folder that result paths are relative to.
    """
    return {
        "schema": SCHEMA,
        "scanloom": __version__,
        "libraries": {"python": platform.python_version(), **list_installed_versions(*_LIBRARIES)},
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "scan": {
            "layout": scan.layout,
            "frames": len(scan.frames),
            "frames_skipped": [one.to_dict() for one in scan.skipped_frames],
            "diagnostics": [one.to_dict() for one in diagnostics],
            # If false, lengths in all metrics are in units of the scan instead of metres.
            "metric": scan.is_metric,
            "scale": scan.scale and scan.scale.to_dict(),
        },
        "stages": {outcome.stage: _describe_stage(outcome, out) for outcome in outcomes},
        "mesh": final.get("mesh"),
        # None unless remesh is enabled.
        "normal_mesh": final.get("normal_mesh"),
        # None unless frames were held out.
        "held_out": final.get("held_out"),
        # Signed deviation of the result from the refined mesh; None unless the run reached the report.
        "deviation": final.get("deviation"),
        "pictures": final.get("pictures", []),
    }


def _describe_stage(outcome: StageOutcome, out: Path) -> dict[str, Any]:
    stage = find_stage(outcome.stage)
    return {
        "cached": outcome.cached,
        "reason": outcome.reason,
        "seconds": round(outcome.seconds, 3),
        # Time and memory of the run that computed the result: an earlier run if the result was cached.
        "compute_seconds": outcome.compute_cost["seconds"],
        "peak_memory_mb": round(outcome.compute_cost["peak_memory_bytes"] / 1e6, 1),
        "params": outcome.params,
        "metrics": {} if stage is not None and stage.is_summary else outcome.metrics,
        "diagnostics": [one.to_dict() for one in outcome.diagnostics],
        "results": [path.relative_to(out).as_posix() for path in outcome.results],
    }
