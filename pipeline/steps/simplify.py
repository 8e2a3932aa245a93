"""Stage `simplify`: reduces the triangles of the refined mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.pipeline.artifacts.file_names import DEVIATION_PROPERTY
from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.cost_model import MAX_BYTES_IN_CHUNKS, CostModel
from scanloom.pipeline.result_versions import collect_result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.refine import RefinedMesh, is_refined_mesh_large
from scanloom.stages.comparing.certify import certify
from scanloom.stages.comparing.compare import compare_surfaces
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.files.documents import read_json
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.simplification.chunked_simplify import ChunkedSimplifyResult, simplify_chunked
from scanloom.stages.simplification.method_selection import has_no_goal, select_method
from scanloom.stages.simplification.methods import METHODS
from scanloom.stages.simplification.params import AUTO
from scanloom.stages.simplification.result import SimplificationResult
from scanloom.stages.simplification.simplify import SimplifyParams, simplify
from scanloom.stages.surface.formats.ply import read_vertex_values, write_ply
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.bake import bake

_PROOF_FILE = "proven.json"

# Standard deviation of surface that was not measured more than once, in mean edge lengths.
_DEVIATION_EDGES = 0.25

# Methods in which the weight of colours may be 0.
_COLOR_METHODS = (AUTO, "certified", "quadric")

# Functions whose versions determine a simplified mesh with baked images.
SIMPLIFICATION_FUNCTIONS = (simplify, bake, compare_surfaces)


@dataclass(frozen=True)
class Proof:
    """Proven two-sided distance of a simplified mesh from its large input mesh.

    Attributes
    ----------
    shape_bound_m : bound on the distance in metres.
    color_bound_levels : bound on the colour error in grey levels; None without colours.
    """

    shape_bound_m: float
    color_bound_levels: float | None


@dataclass(frozen=True)
class SimplifiedMesh(MeshFile):
    """Simplified mesh."""

    NAME = "simplified_mesh"
    FILE = "simplified.ply"

    def load_proof(self) -> Proof | None:
        """Load the proof of a mesh that was simplified in chunks.

        Returns None if not available.
        """
        if not (self.folder / _PROOF_FILE).is_file():
            return None
        proven: Any = read_json(self.folder / _PROOF_FILE)
        return None if proven is None else Proof(**proven)


@dataclass(frozen=True, kw_only=True)
class SimplifyInputs:
    """Inputs of the stage `simplify`.

    Attributes
    ----------
    is_textured : True if the simplified mesh gets a texture, so that its vertex colours do not matter.
    """

    refined_mesh: RefinedMesh
    is_textured: bool = False


def _run(inputs: SimplifyInputs, params: SimplifyParams, context: Context) -> Mapping[str, Any]:
    refined, folder = inputs.refined_mesh, context.folder
    params = _ignore_colors(params) if inputs.is_textured else params
    simplified: SimplificationResult[Any] | ChunkedSimplifyResult
    if refined.is_large:
        simplified = simplify_chunked(refined.path, params, scratch=folder, progress=context.progress)
        _write_proof(folder, simplified.to_dict())
    else:
        mesh = refined.load()
        deviations = _load_deviations(refined, mesh) if inputs.is_textured else None
        simplified = simplify(mesh, params, deviations=deviations, progress=context.progress)
    write_ply(folder / SimplifiedMesh.FILE, simplified.mesh)
    return simplified.to_dict()


def _load_deviations(refined: RefinedMesh, mesh: Mesh) -> NDArray[np.float64] | None:
    """Load the standard deviation of each vertex; a part of the mean edge length if it was not measured.

    Returns None if no edge has a length.
    """
    deviations = read_vertex_values(refined.path, DEVIATION_PROPERTY)
    if deviations is not None and deviations.any():
        return deviations
    corners = mesh.vertices[mesh.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    mean = float(lengths.mean()) if lengths.size else 0.0
    return np.full(len(mesh.vertices), _DEVIATION_EDGES * mean) if mean > 0 else None


def _ignore_colors(params: SimplifyParams) -> SimplifyParams:
    """Give vertex colours no weight, unless the parameters say how they count."""
    is_given = params.attribute_scale is not None or params.max_color is not None
    return params if is_given or params.method not in _COLOR_METHODS else replace(params, attribute_scale=0.0)


def _write_proof(folder: Path, metrics: Mapping[str, Any]) -> None:
    proves = any(method.proves_bounds for method in METHODS if method.name == metrics["method"])
    details = metrics["details"]
    proven = {field.name: details[field.name] for field in fields(Proof)} if proves else None
    (folder / _PROOF_FILE).write_text(json.dumps(proven) + "\n", encoding="utf-8", newline="\n")


def list_method_versions() -> dict[str, int]:
    """Return the versions of all simplification methods."""
    return {method.name: method.result_version for method in METHODS}


def _list_versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:
    params = config.get(SimplifyParams)
    if known.get("is_textured"):
        params = _ignore_colors(params)
        if has_no_goal(params):
            params = replace(params, max_shape=1.0)  # a bound will be derived
    try:
        method = select_method(params)  # The refined mesh has no texture that could require another method.
    except UsageError:
        return collect_result_versions(simplify)  # No method applies; the stage itself reports the error.
    return {
        # The refined mesh has no images, so baking only happens on request.
        **collect_result_versions(*(SIMPLIFICATION_FUNCTIONS if params.bake else (simplify,))),
        **(collect_result_versions(simplify_chunked) if is_refined_mesh_large(known) else {}),
        method.name: method.result_version,
        **(collect_result_versions(certify) if method.proves_bounds else {}),
    }


def _format_headline(metrics: Mapping[str, Any]) -> str:
    return next((one.details.headline for one in METHODS if one.name == metrics.get("method")), "")


STAGE = Stage(
    name="simplify",
    section=SimplifyParams,
    inputs=SimplifyInputs,
    artifact=SimplifiedMesh,
    run=_run,
    versions=_list_versions,
    libraries=list_installed_versions("scanloom"),
    result_names=(SimplifiedMesh.FILE,),
    cost=CostModel(seconds_per_megapixel=0.15, max_bytes=MAX_BYTES_IN_CHUNKS),
    headline=_format_headline,
    progress_unit="triangles",
)
