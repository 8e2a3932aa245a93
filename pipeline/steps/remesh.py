"""Optional stage `remesh`: converts the simplified mesh to a normal mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.up_direction import UpDirection
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.simplify import SIMPLIFICATION_FUNCTIONS, SimplifiedMesh, list_method_versions
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.normal_meshes.remesh import RemeshParams, remesh
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh


@dataclass(frozen=True, kw_only=True)
class RemeshSection(RemeshParams):
    """Normal mesh of the simplified mesh."""

    enabled: bool = param(
        False,
        "Convert the simplified mesh to a normal mesh: regular triangles at several levels of detail, in a "
        "small file.",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )


@dataclass(frozen=True)
class NormalMeshFiles(Artifact):
    """Normal mesh: its file, its finest level, and all levels."""

    NAME = "normal_mesh"

    def load_levels(self) -> list[Mesh]:
        """Load the levels, the base mesh first."""
        count = len(list((self.folder / "levels").iterdir()))
        return [read_ply(self.folder / "levels" / f"level_{level}.ply") for level in range(count)]


@dataclass(frozen=True, kw_only=True)
class RemeshInputs:
    """Inputs of the stage `remesh`."""

    simplified_mesh: SimplifiedMesh
    up_direction: UpDirection


def _run(inputs: RemeshInputs, params: RemeshSection, context: Context) -> Mapping[str, Any]:
    mesh = inputs.simplified_mesh.load().with_(up=inputs.up_direction.load())
    return write_normal_mesh(context.folder, mesh, params, context.progress)


def write_normal_mesh(folder: Path, mesh: Mesh, params: RemeshSection, progress: Progress) -> dict[str, Any]:
    """Remesh, write remeshed.ply, remeshed.snm and the folder levels/, and return metrics."""
    found = remesh(mesh, params, progress=progress)
    found.write(folder / "remeshed.ply")
    found.write_levels(folder / "levels")
    found.save(folder / "remeshed.snm")
    return found.to_dict()


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:  # noqa: ARG001
    # The base mesh is made by a simplification method.
    return {**collect_result_versions(remesh, *SIMPLIFICATION_FUNCTIONS), **list_method_versions()}


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    return None if config.get(RemeshSection).enabled else "is not enabled; set remesh.enabled=true"


STAGE = Stage(
    name="remesh",
    section=RemeshSection,
    inputs=RemeshInputs,
    artifact=NormalMeshFiles,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("scanloom"),
    result_names=("remeshed.ply", "remeshed.snm", "levels/"),
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=2, seconds_per_megapixel=0.5, bytes=300e6),
    headline="{triangles:,} triangles after {levels} levels from {base_triangles:,}; "
    "{exceptions:,} exceptions; {file_bytes:,} bytes",
    progress_unit="levels",
)
