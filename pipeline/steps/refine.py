"""Stage `refine`: removes the noise of the sensor from the clean mesh.

refined.ply            mesh, ordered by chunks; vertex property `deviation`: standard deviation along the
                       normal, metres; `filled`: 1 inside of closed holes, otherwise 0. Both are missing if
                       the clean mesh is too large to be refined
refined.pieces.json    chunk table, if the mesh exceeds the in-memory limit
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.depth_maps import DepthMaps
from scanloom.pipeline.artifacts.file_names import DEVIATION_PROPERTY, FILLED_PROPERTY
from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.artifacts.posed_frames import PosedFrames
from scanloom.pipeline.cost_model import BASE_BYTES, CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh, is_clean_mesh_large
from scanloom.stages.cleaning.clean import clean
from scanloom.stages.comparing.certify import certify
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.fusion.depth_noise import estimate_depth_noise
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.params import param
from scanloom.stages.refinement.params import RefineParams
from scanloom.stages.refinement.refine import estimate_memory, refine
from scanloom.stages.surface.chunk_partition import write_in_chunks
from scanloom.stages.surface.chunked_ply import ChunkedPly, make_table_path
from scanloom.stages.surface.codes import FUSE_TOO_LARGE
from scanloom.stages.surface.formats.ply import read_vertex_values
from scanloom.stages.surface.mesh import Mesh


@dataclass(frozen=True, kw_only=True)
class RefineSection(RefineParams):
    """Refinement of the clean mesh."""

    memory: float = param(
        8000.0,
        "Memory limit for a mesh in chunks, which has more than 5 million triangles; if it needs more, it "
        "stays as it is.",
        unit="MB",
        low=1,
        # The versions in the cache key tell if the mesh was refined.
        invalidates=False,
    )

    def has_memory_for(self, triangles: int) -> bool:
        """Return True if a mesh with this triangle count can be refined within the memory limit."""
        return estimate_memory(triangles) <= self.memory * 1e6


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


def _run(inputs: RefineInputs, params: RefineSection, context: Context) -> Mapping[str, Any]:
    result = context.folder / RefinedMesh.FILE
    if _is_kept({"clean_mesh": inputs.clean_mesh}, params):
        return _copy_mesh(inputs.clean_mesh, result, params)
    refined = refine(
        _load_mesh(inputs.clean_mesh),
        inputs.load_posed(),
        params,
        progress=context.progress,
        has_matched_depth=isinstance(inputs.frames, DepthMaps),
    )
    values = {
        DEVIATION_PROPERTY: refined.deviations.astype(np.float32),
        FILLED_PROPERTY: refined.is_filled.astype(np.float32),
    }
    write_in_chunks(result, refined.mesh, values)
    metrics = refined.to_dict()
    warn_skipped_frames(metrics["frames_skipped"])
    return metrics


def _is_kept(known: Mapping[str, Any], params: RefineSection) -> bool:
    """Return True if the clean mesh is too large to be refined; False if it is not known yet."""
    return is_clean_mesh_large(known) and not params.has_memory_for(known["clean_mesh"].triangle_count)


def _load_mesh(clean_mesh: CleanMesh) -> Mesh:
    return ChunkedPly(clean_mesh.path).read_mesh() if clean_mesh.is_large else clean_mesh.load()


def _copy_mesh(clean_mesh: CleanMesh, result: Path, params: RefineSection) -> Mapping[str, Any]:
    shutil.copyfile(clean_mesh.path, result)
    shutil.copyfile(make_table_path(clean_mesh.path), make_table_path(result))
    count = clean_mesh.triangle_count
    emit(
        FUSE_TOO_LARGE.warning(
            "the mesh is not refined: its {triangles:,} triangles need {needed:.2g} GB of memory, more than "
            "the limit of {limit:.2g} GB for this stage",
            remedy="Increase refine.memory and the memory limit of the run, or fuse.voxel_size.",
            triangles=count,
            needed=estimate_memory(count) / 1e9,
            limit=params.memory / 1e3,
        )
    )
    return {"triangles": count, "why": "refinement needs more memory than refine.memory allows"}


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:
    if _is_kept(known, config.get(RefineSection)):
        return {"copy": 1}
    # `clean` may repair, which `refine` does not ask for; its versions are few enough to be included.
    return collect_result_versions(refine, estimate_depth_noise, clean, certify)


def _compute_memory_bound(config: Sections) -> float:
    return BASE_BYTES + 1e6 * config.get(RefineSection).memory


def _format_headline(metrics: Mapping[str, Any]) -> str:
    if metrics["why"]:
        return "{triangles:,} triangles, left as they are: {why}"
    moved = "{triangles:,} triangles; moved by {move_rms_m:.2g} m RMS; {planes:,} planes"
    return moved + ("; {filled_holes:,} holes filled" if metrics["filled_holes"] else "")


STAGE = Stage(
    name="refine",
    section=RefineSection,
    inputs=RefineInputs,
    labels=("names",),
    artifact=RefinedMesh,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("scanloom", "opencv", "scipy"),
    result_names=(RefinedMesh.FILE,),
    cost=CostModel(seconds_per_megapixel=0.4),
    headline=_format_headline,
    progress_unit="frames",
    memory_bound=_compute_memory_bound,
)
