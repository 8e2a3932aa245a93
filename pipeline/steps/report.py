"""Stage `report`: measures and draws the results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

from scanloom.pipeline.artifacts.file_names import PICTURES
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.fuse import FusedMesh
from scanloom.pipeline.steps.refine import RefinedMesh
from scanloom.pipeline.steps.remesh import NormalMeshFiles
from scanloom.pipeline.steps.simplify import SimplifiedMesh
from scanloom.pipeline.steps.texture import TexturedMesh
from scanloom.stages.comparing.compare import CompareParams
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.scans.model.scan import Frame, Scan
from scanloom.stages.scans.params import ScanParams


@dataclass(frozen=True)
class ReportFiles(Artifact):
    """Pictures, cameras and photos for the page."""

    NAME = "report"


@dataclass(frozen=True, kw_only=True)
class ReportInputs(PosedFrames):
    """Inputs of the stage `report`.

    Attributes
    ----------
    held_out : held-out frames.
    """

    fused_mesh: FusedMesh
    refined_mesh: RefinedMesh
    simplified_mesh: SimplifiedMesh
    textured_mesh: TexturedMesh | None = None
    normal_mesh: NormalMeshFiles | None = None
    held_out: Scan | None = None


def _run(inputs: ReportInputs, params: ReportParams, context: Context) -> Mapping[str, Any]:
    # Imported late: declaring the stage must not import the renderer.
    from scanloom.pipeline.evaluation import held_out_frames, measurements

    compared = context.config.get(CompareParams)
    simplified = inputs.simplified_mesh.load()
    meshes = {
        "fused": inputs.fused_mesh.load_in_chunks(),
        "refined": inputs.refined_mesh.load_in_chunks(),
        "simplified": simplified,
    }
    textured, by_photo = inputs.textured_mesh, None
    result = simplified
    if textured is not None:
        meshes["textured"] = result = textured.load()
        by_photo = partial(textured.color_by_photo, result)
    pictures = context.folder / PICTURES
    pictures.mkdir()
    frames = inputs.load_posed().frames
    others = _load_held_out(inputs, context.config)
    report = measurements.measure_and_draw(
        pictures,
        meshes,
        frames,
        compared,
        params,
        context.progress,
        by_photo,
        others,
        inputs.refined_mesh.load_filled(),
    )
    drawn_in = pictures if params.pictures else None
    if inputs.normal_mesh is not None:
        viewpoint = measurements.choose_viewpoints(meshes["fused"], frames, params)[-1]
        levels = inputs.normal_mesh.load_levels()
        report["normal_mesh"], drawn = measurements.measure_and_draw_levels(
            drawn_in, simplified, levels, viewpoint, compared
        )
        report["pictures"] += drawn
    if inputs.held_out is not None:
        report["held_out"], drawn = held_out_frames.evaluate_held_out(
            drawn_in, result, others, context.progress
        )
        report["pictures"] += drawn
    return {**report, "pictures": [f"{PICTURES}/{name}" for name in report["pictures"]]}


def _load_held_out(inputs: ReportInputs, config: Sections) -> list[Frame]:
    """Load the held-out frames with poses transferred from their neighbours."""
    from scanloom.pipeline.evaluation.held_out_frames import transfer_neighbour_poses

    if inputs.held_out is None:
        return []
    scan, every = inputs.load_scan(), config.get(ScanParams).hold_out
    assert every is not None
    return transfer_neighbour_poses(inputs.held_out.frames, every, scan.frames, inputs.apply_to(scan).frames)


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    from scanloom.pipeline.evaluation.measurements import measure_and_draw
    from scanloom.stages.comparing.compare import compare_surfaces
    from scanloom.stages.comparing.held_out_views import evaluate_held_out_photos

    return collect_result_versions(measure_and_draw, compare_surfaces, evaluate_held_out_photos)


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    return None if config.get(ReportParams).enabled else "is switched off; set report.enabled=true"


STAGE = Stage(
    name="report",
    section=ReportParams,
    inputs=ReportInputs,
    labels=("names",),
    artifact=ReportFiles,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("open3d", "opencv", "scikit-image"),
    extra_sections=("compare",),
    result_names=(f"{PICTURES}/",),
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=6, seconds_per_megapixel=0.2, bytes=300e6, max_bytes=MAX_BYTES_IN_CHUNKS),
    headline="{pictures} pictures",
    is_summary=True,
)
