"""Stage `simplify`: reduces the triangles of the clean mesh."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.mesh_file import MeshFile
from scanloom.pipeline.expectation import MAX_BYTES_IN_PARTS, Cost
from scanloom.pipeline.result_versions import result_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Context, Stage
from scanloom.pipeline.steps.clean import CleanMesh, is_clean_mesh_large
from scanloom.stages.comparing.certify import certify
from scanloom.stages.comparing.compare import compare_surfaces
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.files.documents import read_json
from scanloom.stages.inspecting.libraries import installed
from scanloom.stages.simplification.auto import chosen
from scanloom.stages.simplification.methods import METHODS
from scanloom.stages.simplification.result import Simplified
from scanloom.stages.simplification.simplify import SimplifyParams, simplify
from scanloom.stages.simplification.simplify_in_pieces import InPieces, simplify_in_pieces
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.texturing.bake import bake

_PROOF = "proven.json"

# Functions whose versions determine a simplified mesh with baked images.
SIMPLIFICATION = (simplify, bake, compare_surfaces)


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
        if not (self.folder / _PROOF).is_file():
            return None
        proven: Any = read_json(self.folder / _PROOF)
        return None if proven is None else Proof(**proven)


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Inputs of the stage `simplify`."""

    clean_mesh: CleanMesh


def _run(inputs: Inputs, params: SimplifyParams, context: Context) -> Mapping[str, Any]:
    clean, folder = inputs.clean_mesh, context.folder
    simplified: Simplified[Any] | InPieces
    if clean.is_large:
        simplified = simplify_in_pieces(clean.path, params, scratch=folder, progress=context.progress)
        _write_proof(folder, simplified.figures())
    else:
        simplified = simplify(clean.load(), params, progress=context.progress)
    write_ply(folder / SimplifiedMesh.FILE, simplified.mesh)
    return simplified.figures()


def _write_proof(folder: Path, figures: Mapping[str, Any]) -> None:
    proves = any(method.proves for method in METHODS if method.name == figures["method"])
    details = figures["details"]
    proven = {field.name: details[field.name] for field in fields(Proof)} if proves else None
    (folder / _PROOF).write_text(json.dumps(proven) + "\n", encoding="utf-8", newline="\n")


def method_versions() -> dict[str, int]:
    """Return the versions of all simplification methods."""
    return {method.name: method.result_version for method in METHODS}


def _versions(known: Mapping[str, Any], config: Sections) -> Mapping[str, int]:
    params = config.get(SimplifyParams)
    try:
        method = chosen(params)  # The clean mesh has no texture that could require another method.
    except UsageError:
        return result_versions(simplify)  # No method applies; the stage itself reports the error.
    return {
        # The clean mesh has no images, so baking only happens on request.
        **result_versions(*(SIMPLIFICATION if params.bake else (simplify,))),
        **(result_versions(simplify_in_pieces) if is_clean_mesh_large(known) else {}),
        method.name: method.result_version,
        **(result_versions(certify) if method.proves else {}),
    }


def _headline(figures: Mapping[str, Any]) -> str:
    return next((one.details.headline for one in METHODS if one.name == figures.get("method")), "")


STAGE = Stage(
    name="simplify",
    section=SimplifyParams,
    inputs=Inputs,
    writes=SimplifiedMesh,
    run=_run,
    versions=_versions,
    libraries=installed("scanloom"),
    results=(SimplifiedMesh.FILE,),
    cost=Cost(seconds_per_megapixel=0.15, most_bytes=MAX_BYTES_IN_PARTS),
    headline=_headline,
    progress_unit="triangles",
)
