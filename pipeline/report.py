"""The report: what is measured on the meshes, pictures of them, and what a run adds to that.

Measures and pictures depend on the meshes alone and are cached as any stage's result. Seconds, and what was
cached, belong to one run; `compose` puts both together.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.engine import Outcome
from stages.compare import CompareParams
from stages.mesh import Mesh
from stages.params import check, param
from stages.scan import Frame, Scan

VERSION = 1
# Of report.json: raised when a name changes its meaning or disappears.
SCHEMA = 1


@dataclass(frozen=True, kw_only=True)
class ReportParams:
    """Pictures of each stage's mesh."""

    views: int = param(3, "Number of viewpoints; every mesh is drawn from each.", low=1, high=100)
    width: int = param(800, "Width of a picture.", unit="px", low=64, high=4096)

    def __post_init__(self) -> None:
        check(self)


def measure(mesh: Mesh, fused: Mesh, params: CompareParams) -> dict[str, Any]:
    """Measure the final mesh: its counts, its edges, and how far it is from the fused one."""
    from stages.compare import compare
    from stages.topology import topology

    found = topology(mesh)
    return {
        "vertices": len(mesh.vertices),
        "triangles": len(mesh.triangles),
        "manifold": found.is_manifold,
        "oriented": found.is_oriented,
        "boundary_loops": found.boundary_loops,
        "components": found.components,
        "edges": edge_figures(mesh),
        "to_fused": compare(fused, mesh, params).figures(),
    }


def edge_figures(mesh: Mesh) -> dict[str, Any]:
    """Return mean and spread of the edges' lengths; every edge counts once."""
    ends = np.sort(mesh.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    count = len(mesh.vertices)
    # An edge as one number: sorting numbers is several times faster than sorting rows.
    edges = np.unique(ends[:, 0] * count + ends[:, 1])
    lengths = np.linalg.norm(mesh.vertices[edges // count] - mesh.vertices[edges % count], axis=1)
    if len(lengths) == 0:
        return {"count": 0}
    return {
        "count": len(edges),
        "length_mean_m": float(lengths.mean()),
        "length_deviation_m": float(lengths.std()),
        "length_minimum_m": float(lengths.min()),
        "length_maximum_m": float(lengths.max()),
    }


def draw(
    folder: Path, meshes: Mapping[str, Mesh], frames: Sequence[Frame], params: ReportParams
) -> list[str]:
    """Write a PNG of each mesh from each viewpoint, `<mesh>-<view>.png`, and return the names.

    Parameters
    ----------
    meshes : by the name of their stage; the viewpoints are those of the first.
    frames : of the scan, whose poses say where to look from.
    """
    from stages.render import render_all, viewpoints, write_png

    # A view is named after its frame; numbers, because the names of files decide nothing here.
    numbered = [replace(frame, name=f"{i:06d}") for i, frame in enumerate(frames)]
    views = viewpoints(next(iter(meshes.values())), params.views, frames=numbered, width=params.width)
    names = []
    for stage, mesh in meshes.items():
        for view, image in zip(views, render_all(mesh, views), strict=True):
            names.append(f"{stage}-{view.name}.png")
            write_png(folder / names[-1], image)
    return names


def compose(scan: Scan, outcomes: Sequence[Outcome], final: Mapping[str, Any], out: Path) -> dict[str, Any]:
    """Put together the content of report.json.

    Parameters
    ----------
    outcomes : what became of each stage of this run.
    final : figures of the report stage; empty if the run ended before it.
    out : the output folder, which results are named from.
    """
    return {
        "schema": SCHEMA,
        "scanloom": version("scanloom"),
        "created": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "scan": {
            "layout": scan.layout,
            "frames": len(scan.frames),
            "frames_skipped": [{"frame": one.name, "reason": one.reason} for one in scan.skipped],
            "warnings": list(scan.warnings),
        },
        "stages": {outcome.stage: _stage(outcome, out) for outcome in outcomes},
        "mesh": final.get("mesh"),
        "pictures": final.get("pictures", []),
    }


def _stage(outcome: Outcome, out: Path) -> dict[str, Any]:
    return {
        "cached": outcome.cached,
        "reason": outcome.reason,
        "seconds": round(outcome.seconds, 3),
        # Of the run that made the result, which is this one unless it was cached.
        "made_in_s": outcome.made["seconds"],
        "peak_memory_mb": round(outcome.made["peak_memory_bytes"] / 1e6, 1),
        "params": outcome.params,
        "figures": {} if outcome.stage == "report" else outcome.figures,
        "results": [path.relative_to(out).as_posix() for path in outcome.results],
    }


def to_json(report: Mapping[str, Any]) -> str:
    """Return the text of report.json."""
    return json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False) + "\n"
