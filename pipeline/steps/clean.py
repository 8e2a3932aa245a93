"""Stage `clean`: removes islands and defects from the fused mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.expectation import MAX_BYTES_IN_PARTS, Cost
from scanloom.pipeline.result_versions import result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.fuse import FusedMesh
from scanloom.stages.cleaning.clean import CleanParams, clean
from scanloom.stages.cleaning.clean_in_pieces import clean_in_pieces
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
class Inputs:
    """Inputs of the stage `clean`."""

    fused_mesh: FusedMesh


def _run(inputs: Inputs, params: CleanParams, context: Context) -> Mapping[str, Any]:
    result = context.folder / CleanMesh.FILE
    if inputs.fused_mesh.is_large:
        return clean_in_pieces(inputs.fused_mesh.path, result, params, progress=context.progress)
    cleaned = clean(inputs.fused_mesh.load(), params)
    write_ply(result, cleaned.mesh)
    return cleaned.figures()


def _versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    # Repairs are validated by a certificate, so its code version matters.
    return result_versions(clean, certify) if config.get(CleanParams).repair else result_versions(clean)


STAGE = Stage(
    name="clean",
    section=CleanParams,
    inputs=Inputs,
    writes=CleanMesh,
    run=_run,
    versions=_versions,
    results=(CleanMesh.FILE,),
    cost=Cost(seconds_per_megapixel=0.08, most_bytes=MAX_BYTES_IN_PARTS),
    headline="{triangles:,} triangles; {islands:,} islands removed",
)
