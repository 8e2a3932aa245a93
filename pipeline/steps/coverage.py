"""Optional stage `coverage`: finds gaps of the scan.

coverage.ply    clean mesh coloured by coverage, with faces that close its holes; vertex properties: VALUES
coverage.glb    the same, rotated upright; not written for a mesh above the in-memory limit
coverage.json   list of gaps and metrics
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import COVERAGE, COVERAGE_MESH
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.artifacts.up_direction import Up, UpDirection
from scanloom.pipeline.expectation import MAX_BYTES_IN_PARTS, Cost
from scanloom.pipeline.result_versions import always
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped import emit_skipped
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.inspecting.codes import COVERAGE_LIMITED
from scanloom.stages.inspecting.coverage.coverage import coverage
from scanloom.stages.inspecting.coverage.covered import Covered
from scanloom.stages.inspecting.coverage.evidence import Evidence
from scanloom.stages.inspecting.coverage.params import CoverageParams
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import write_mesh
from scanloom.stages.surface.pieces import Written, write_by_pieces
from scanloom.stages.surface.piecewise import Piecewise

MODEL = "coverage.glb"
# Vertex properties: number of frames that measured the vertex; minimum and mean viewing angle to the normal,
# degrees; pixel width, metres; RMS distance of the measurements from the surface, metres. Vertices seen by no
# frame have 0 frames, 90°, 90°, 0 and 0.
VALUES = ("frames", "angle", "mean_angle", "pixel", "spread")


@dataclass(frozen=True, kw_only=True)
class CoverageSection(CoverageParams):
    """Gaps of the scan."""

    enabled: bool = param(
        False,
        "Find the gaps of the scan: holes, regions that no frame saw, and surface with few observations. "
        "`scanloom coverage OUT` does it for a finished run.",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )


@dataclass(frozen=True)
class CoverageMap(Artifact):
    """Clean mesh coloured by coverage, and the list of gaps."""

    NAME = "coverage_map"


@dataclass(frozen=True, kw_only=True)
class Inputs(PosedFrames):
    """Inputs of the stage `coverage`."""

    clean_mesh: CleanMesh
    up_direction: UpDirection


def _run(inputs: Inputs, params: CoverageSection, context: Context) -> Mapping[str, Any]:
    scan = inputs.load_posed()
    mesh, up = inputs.clean_mesh.load_surface(), inputs.up_direction.load()
    figures = write_coverage(context.folder, mesh, scan.frames, params, up, context.progress)
    emit_skipped(figures["frames_skipped"])
    return figures


def _skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    return None if config.get(CoverageSection).enabled else "is not enabled; set coverage.enabled=true"


def write_coverage(
    folder: Path,
    mesh: Mesh | Piecewise,
    frames: Sequence[Frame],
    params: CoverageSection,
    up: Up | None,
    progress: Progress,
) -> dict[str, Any]:
    """Analyse the coverage, write coverage.ply, coverage.glb and coverage.json, and return metrics."""
    found = coverage(mesh, frames, params, progress=progress)
    figures = found.figures()
    (folder / COVERAGE).write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8", newline="\n")
    told = {**figures, "places": len(found.places)}
    if isinstance(mesh, Piecewise):
        _write_in_pieces(folder / COVERAGE_MESH, found.covered)
        return told
    rows = np.concatenate([part.probes for part in found.covered.painted()])
    values = dict(zip(VALUES, values_of(found.covered.evidence.at(rows)).T, strict=True))
    write_ply(folder / COVERAGE_MESH, found.painted, vertex_values=values)
    write_mesh(folder / MODEL, found.painted.with_(up=up))
    return told


def _write_in_pieces(path: Path, covered: Covered) -> None:
    """Write coverage.ply of a large mesh in chunks, and warn that coverage.glb is missing."""
    pieces = (
        Written(part.vertices, part.colors, part.triangles, values_of(covered.evidence.at(part.probes)))
        for part in covered.painted()
    )
    count = covered.triangle_count
    write_by_pieces(path, covered.vertex_count, count, pieces, has_colors=True, values=VALUES)
    emit(
        COVERAGE_LIMITED.warning(
            "{model} is not written: {triangles:,} triangles are too many for viewers; {file} has the mesh.",
            model=MODEL,
            triangles=count,
            file=path.name,
        )
    )


def values_of(evidence: Evidence) -> NDArray[np.float32]:
    """Return the vertex properties VALUES as an array (n, 5)."""
    is_seen = evidence.frames > 0
    angles = (np.degrees(np.arccos(cosine.clip(0, 1))) for cosine in (evidence.cosine, evidence.mean_cosine))
    pixel = np.where(is_seen, evidence.pixel, 0.0)
    return np.stack([evidence.frames, *angles, pixel, evidence.spread], axis=1).astype(np.float32)


STAGE = Stage(
    name="coverage",
    section=CoverageSection,
    inputs=Inputs,
    labels=("names",),
    writes=CoverageMap,
    run=_run,
    versions=always(coverage),
    libraries=installed("open3d", "opencv", "scipy"),
    results=(COVERAGE_MESH, MODEL, COVERAGE),
    skip_reason=_skip_reason,
    cost=Cost(seconds=2, seconds_per_megapixel=0.15, bytes=300e6, most_bytes=MAX_BYTES_IN_PARTS),
    headline="{places} gaps",
    progress_unit="frames",
)
