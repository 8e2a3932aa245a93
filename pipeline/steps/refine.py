"""Stage `refine`: removes the noise of the sensor from the clean mesh.

refined.ply            mesh; vertex property `deviation`: standard deviation along the normal, metres;
                       `filled`: 1 inside of closed holes, otherwise 0
refined.pieces.json    chunk table, if the mesh exceeds the in-memory limit; it is then the clean mesh
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import FILLED_PROPERTY
from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh
from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.certify import certify
from scanloom.stages.fusion.depth_noise import estimate_depth_noise
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.refinement.params import RefineParams
from scanloom.stages.refinement.refine import refine
from scanloom.stages.surface.chunked_ply import make_table_path
from scanloom.stages.surface.formats.ply import read_vertex_values, write_ply


@dataclass(frozen=True)
class RefinedMesh(MeshFile):
    """Refined mesh."""

    NAME = "refined_mesh"
    FILE = "refined.ply"

    def load_filled(self) -> NDArray[np.bool_] | None:
        """Load the mask (n,) of the vertices inside of filled holes; None if the mesh was not refined."""
        values = None if self.is_large else read_vertex_values(self.path, FILLED_PROPERTY)
        return None if values is None else values > 0


def is_refined_mesh_large(known: Mapping[str, Any]) -> bool:
    """Return True if the refined mesh exceeds the in-memory limit.

    Returns False if the refined mesh is not known yet.
    """
    return "refined_mesh" in known and known["refined_mesh"].is_large


@dataclass(frozen=True, kw_only=True)
class RefineInputs(PosedFrames):
    """Inputs of the stage `refine`."""

    clean_mesh: CleanMesh


def _run(inputs: RefineInputs, params: RefineParams, context: Context) -> Mapping[str, Any]:
    result = context.folder / RefinedMesh.FILE
    if inputs.clean_mesh.is_large:
        return _copy_large_mesh(inputs.clean_mesh, result)
    refined = refine(inputs.clean_mesh.load(), inputs.load_posed(), params, progress=context.progress)
    values = {"deviation": refined.deviations, FILLED_PROPERTY: refined.is_filled.astype(np.float64)}
    write_ply(result, refined.mesh, vertex_values=values)
    metrics = refined.to_dict()
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _copy_large_mesh(clean_mesh: CleanMesh, result: Path) -> Mapping[str, Any]:
    shutil.copyfile(clean_mesh.path, result)
    shutil.copyfile(make_table_path(clean_mesh.path), make_table_path(result))
    return {"triangles": clean_mesh.triangle_count, "why": "it is processed in chunks"}


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    # `clean` may repair, which `refine` does not ask for; its versions are few enough to be included.
    return collect_result_versions(refine, estimate_depth_noise, clean, certify)


def _format_headline(metrics: Mapping[str, Any]) -> str:
    if metrics["why"]:
        return "{triangles:,} triangles, left as they are: {why}"
    moved = "{triangles:,} triangles; moved by {move_rms_m:.2g} m RMS; {planes:,} planes"
    return moved + ("; {filled_holes:,} holes filled" if metrics["filled_holes"] else "")


STAGE = Stage(
    name="refine",
    section=RefineParams,
    inputs=RefineInputs,
    labels=("names",),
    artifact=RefinedMesh,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("scanloom", "opencv", "scipy"),
    result_names=(RefinedMesh.FILE,),
    cost=CostModel(seconds_per_megapixel=0.4, max_bytes=MAX_BYTES_IN_CHUNKS),
    headline=_format_headline,
    progress_unit="frames",
)
