"""Stage `clean`: removes islands and defects from the fused mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.fuse import FusedMesh
from scanloom.stages.cleaning.chunked_clean import clean_chunked
from scanloom.stages.cleaning.clean import CleanParams, clean
from scanloom.stages.comparing.certify import certify
from scanloom.stages.surface.formats.ply import write_ply


@dataclass(frozen=True)
class CleanMesh(MeshFile):
    """Cleaned mesh."""

    NAME = "clean_mesh"
    FILE = "clean.ply"


def is_clean_mesh_large(known: Mapping[str, Any]) -> bool:
    """Return True if the clean mesh exceeds the in-memory limit.

    Returns False if the clean mesh is not known yet.
    """
    return "clean_mesh" in known and known["clean_mesh"].is_large


@dataclass(frozen=True, kw_only=True)
class CleanInputs:
    """Inputs of the stage `clean`."""

    fused_mesh: FusedMesh


def _run(inputs: CleanInputs, params: CleanParams, context: Context) -> Mapping[str, Any]:
    result = context.folder / CleanMesh.FILE
    if inputs.fused_mesh.is_large:
        return clean_chunked(inputs.fused_mesh.path, result, params, progress=context.progress)
    cleaned = clean(inputs.fused_mesh.load(), params)
    write_ply(result, cleaned.mesh)
    return cleaned.to_dict()


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    # Repairs are validated by a certificate, so its code version matters.
    return (
        collect_result_versions(clean, certify)
        if config.get(CleanParams).repair
        else collect_result_versions(clean)
    )


STAGE = Stage(
    name="clean",
    section=CleanParams,
    inputs=CleanInputs,
    artifact=CleanMesh,
    run=_run,
    versions=_list_versions,
    result_names=(CleanMesh.FILE,),
    cost=CostModel(seconds_per_megapixel=0.08, max_bytes=MAX_BYTES_IN_CHUNKS),
    headline="{triangles:,} triangles; {islands:,} islands removed",
)
