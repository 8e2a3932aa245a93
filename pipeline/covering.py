"""The optional stage `coverage`: what is missing in a scan.

coverage.ply    the clean mesh in colours of what is missing, and what would close its holes behind it; of
                each vertex `frames`, `angle` (degrees) and `pixel` (metres), how well it was seen there
coverage.glb    the same, upright
coverage.json   the places where one should go again, and the figures
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.standing import Up
from stages.inspecting.coverage.coverage import coverage
from stages.inspecting.coverage.covered import Coverage
from stages.inspecting.coverage.params import CoverageParams
from stages.params import param
from stages.progress import Progress
from stages.scans.scan import Frame
from stages.surface.formats.ply import write_ply
from stages.surface.mesh import Mesh
from stages.surface.mesh_files import write_mesh

MESH, MODEL, FILE = "coverage.ply", "coverage.glb", "coverage.json"


@dataclass(frozen=True, kw_only=True)
class CoverageSection(CoverageParams):
    """Whether a run tells what is missing in the scan, and what counts as that."""

    enabled: bool = param(
        False,
        "Tell what is missing in the scan: holes, what no frame saw, and surface that was hardly seen. "
        "`scanloom coverage OUT` does it afterwards.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )


def make(
    folder: Path,
    mesh: Mesh,
    frames: Sequence[Frame],
    params: CoverageSection,
    up: Up | None,
    progress: Progress,
) -> dict[str, Any]:
    """Write coverage.ply, coverage.glb and coverage.json, and return the figures."""
    found = coverage(mesh, frames, params, progress=progress)
    write_ply(folder / MESH, found.painted, vertex_values=_values(found))
    write_mesh(folder / MODEL, found.painted.with_(up=up))
    figures = found.figures()
    (folder / FILE).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8", newline="\n")
    return {**figures, "places": len(found.places)}


def _values(found: Coverage) -> dict[str, NDArray[np.float64]]:
    """Return what is known of each vertex; of those that close holes, that no frame saw them."""
    evidence, count = found.evidence, len(found.painted.vertices)
    values = {
        "frames": (evidence.frames, 0.0),
        "angle": (np.degrees(np.arccos(evidence.cosine.clip(0, 1))), 90.0),
        "pixel": (np.where(np.isfinite(evidence.pixel), evidence.pixel, 0.0), 0.0),
    }
    return {
        name: np.concatenate([known, np.full(count - len(known), none)]).astype(np.float32)
        for name, (known, none) in values.items()
    }
