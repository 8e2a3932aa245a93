"""Optional stage `coverage`: finds gaps of the scan.

coverage.ply    refined mesh coloured by coverage, with faces that close its holes; vertex properties: VALUES
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
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.refine import RefinedMesh
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.inspecting.codes import COVERAGE_LIMITED
from scanloom.stages.inspecting.coverage.coverage import coverage
from scanloom.stages.inspecting.coverage.coverage_result import SurfaceCoverage
from scanloom.stages.inspecting.coverage.measurement_evidence import Evidence
from scanloom.stages.inspecting.coverage.params import CoverageParams
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.surface.chunked_mesh import ChunkedMesh
from scanloom.stages.surface.chunked_ply import WrittenChunk, write_ply_in_chunks
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.mesh_files import write_mesh

COVERAGE_MODEL = "coverage.glb"
# Vertex properties: number of frames that measured the vertex; minimum and mean viewing angle to the normal,
# degrees; pixel width, metres; RMS distance of the measurements from the surface, metres. Vertices seen by no
# frame have 0 frames, 90°, 90°, 0 and 0.
VERTEX_VALUES = ("frames", "angle", "mean_angle", "pixel", "spread")


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
    """Refined mesh coloured by coverage, and the list of gaps."""

    NAME = "coverage_map"


@dataclass(frozen=True, kw_only=True)
class CoverageInputs(PosedFrames):
    """Inputs of the stage `coverage`."""

    refined_mesh: RefinedMesh
    up_direction: UpDirection


def _run(inputs: CoverageInputs, params: CoverageSection, context: Context) -> Mapping[str, Any]:
    scan = inputs.load_posed()
    mesh, up = inputs.refined_mesh.load_surface(), inputs.up_direction.load()
    metrics = write_coverage(context.folder, mesh, scan.frames, params, up, context.progress)
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    return None if config.get(CoverageSection).enabled else "is not enabled; set coverage.enabled=true"


def write_coverage(
    folder: Path,
    mesh: Mesh | ChunkedMesh,
    frames: Sequence[Frame],
    params: CoverageSection,
    up: Up | None,
    progress: Progress,
) -> dict[str, Any]:
    """Analyse the coverage, write coverage.ply, coverage.glb and coverage.json, and return metrics."""
    found = coverage(mesh, frames, params, progress=progress)
    metrics = found.to_dict()
    (folder / COVERAGE).write_text(json.dumps(metrics, indent=1) + "\n", encoding="utf-8", newline="\n")
    summary = {**metrics, "places": len(found.defects)}
    if isinstance(mesh, ChunkedMesh):
        _write_in_chunks(folder / COVERAGE_MESH, found.surface_coverage)
        return summary
    rows = np.concatenate([part.probe_indices for part in found.surface_coverage.iterate_painted()])
    values = dict(
        zip(VERTEX_VALUES, stack_vertex_values(found.surface_coverage.evidence.select(rows)).T, strict=True)
    )
    write_ply(folder / COVERAGE_MESH, found.painted_mesh, vertex_values=values)
    write_mesh(folder / COVERAGE_MODEL, found.painted_mesh.with_(up=up))
    return summary


def _write_in_chunks(path: Path, coverage_mesh: SurfaceCoverage) -> None:
    """Write coverage.ply of a large mesh in chunks, and warn that coverage.glb is missing."""
    pieces = (
        WrittenChunk(
            part.vertices,
            part.colors,
            part.triangles,
            stack_vertex_values(coverage_mesh.evidence.select(part.probe_indices)),
        )
        for part in coverage_mesh.iterate_painted()
    )
    count = coverage_mesh.triangle_count
    write_ply_in_chunks(
        path, coverage_mesh.vertex_count, count, pieces, has_colors=True, values=VERTEX_VALUES
    )
    emit(
        COVERAGE_LIMITED.warning(
            "{model} is not written: {triangles:,} triangles are too many for viewers; {file} has the mesh.",
            model=COVERAGE_MODEL,
            triangles=count,
            file=path.name,
        )
    )


def stack_vertex_values(evidence: Evidence) -> NDArray[np.float32]:
    """Return the vertex properties VALUES as an array (n, 5)."""
    is_seen = evidence.frame_counts > 0
    angles = (
        np.degrees(np.arccos(cosine.clip(0, 1))) for cosine in (evidence.max_cosine, evidence.mean_cosine)
    )
    pixel = np.where(is_seen, evidence.min_pixel_size, 0.0)
    return np.stack([evidence.frame_counts, *angles, pixel, evidence.rms_height], axis=1).astype(np.float32)


STAGE = Stage(
    name="coverage",
    section=CoverageSection,
    inputs=CoverageInputs,
    labels=("names",),
    artifact=CoverageMap,
    run=_run,
    versions=make_fixed_versions(coverage),
    libraries=list_installed_versions("open3d", "opencv", "scipy"),
    result_names=(COVERAGE_MESH, COVERAGE_MODEL, COVERAGE),
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=2, seconds_per_megapixel=0.15, bytes=300e6, max_bytes=MAX_BYTES_IN_CHUNKS),
    headline="{places} gaps",
    progress_unit="frames",
)
