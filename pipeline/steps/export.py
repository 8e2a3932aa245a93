"""Stage `export`: writes models for other programs.

A glTF file is written if there is no textured.glb, and a compressed model for the web on request.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.up_direction import UpDirection
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.simplify import SimplifiedMesh
from scanloom.pipeline.steps.texture import TexturedMesh
from scanloom.pipeline.steps.texture import get_skip_reason as reason_for_no_texture
from scanloom.stages.exporting.export import ExportParams, export
from scanloom.stages.exporting.presets import preset
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.params import check_parameters, param
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.vertex_normals import compute_vertex_normals

PLAIN_FILE, WEB_FILE = "simplified.glb", "web.glb"


@dataclass(frozen=True, kw_only=True)
class ExportSection:
    """Files for other programs, in addition to textured.glb."""

    web: bool = param(
        False,
        "Write web.glb: a small, unlit model for the web. Viewers must support EXT_meshopt_compression.",
        common=True,
    )

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True)
class ExportedModels(Artifact):
    """Models for other programs."""

    NAME = "exported_models"


@dataclass(frozen=True, kw_only=True)
class ExportInputs:
    """Inputs of the stage `export`."""

    simplified_mesh: SimplifiedMesh
    up_direction: UpDirection
    textured_mesh: TexturedMesh | None = None


def _run(inputs: ExportInputs, params: ExportSection, context: Context) -> Mapping[str, Any]:
    if inputs.textured_mesh is not None:
        mesh, name = inputs.textured_mesh.load(), None
    else:
        mesh, name = inputs.simplified_mesh.load(), PLAIN_FILE
    return write_models(context.folder, mesh.with_(up=inputs.up_direction.load()), name, params)


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:
    if reason_for_no_texture(scan, config) is None and not config.get(ExportSection).web:
        return "has nothing to write: there is a textured.glb; export.web=true writes a small web.glb"
    return None


def write_models(folder: Path, mesh: Mesh, name: str | None, params: ExportSection) -> dict[str, Any]:
    """Export the requested models and return metrics.

    Parameters
    ----------
    mesh : mesh with its up direction.
    name : file name of the uncompressed model; None to write none.
    """
    metrics: dict[str, Any] = {}
    if name is not None:
        shaded = mesh.with_(normals=compute_vertex_normals(mesh)) if len(mesh.triangles) else mesh
        metrics["plain"] = export(shaded, folder / name, ExportParams()).to_dict()
    if params.web:
        metrics["web"] = export(mesh, folder / WEB_FILE, preset("web")).to_dict()
    return metrics


STAGE = Stage(
    name="export",
    section=ExportSection,
    inputs=ExportInputs,
    artifact=ExportedModels,
    run=_run,
    versions=make_fixed_versions(export),
    libraries=list_installed_versions("scanloom", "opencv"),
    result_names=(PLAIN_FILE, WEB_FILE),
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=1, bytes=300e6),
)
