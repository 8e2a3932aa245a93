"""Optional stage `bake`: bakes vertex colours and details into maps.

Colours and details are taken from the refined mesh; the maps are for the simplified mesh.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.up_direction import Up, UpDirection
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.refine import RefinedMesh
from scanloom.pipeline.steps.simplify import SimplifiedMesh
from scanloom.stages.comparing.compare import compare_surfaces
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.surface.formats.gltf_materials import make_unlit
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.bake import BakeParams, bake


@dataclass(frozen=True, kw_only=True)
class BakeSection(BakeParams):
    """Baked texture of the simplified mesh."""

    enabled: bool = param(
        False,
        "Bake the colours and details of the refined mesh into maps of the simplified mesh.",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )


BAKED_FILE = "baked.glb"
BAKED_MAPS = "baked_maps"


@dataclass(frozen=True)
class BakedMesh(Artifact):
    """Simplified mesh with a baked texture."""

    NAME = "baked_mesh"


@dataclass(frozen=True, kw_only=True)
class BakeInputs:
    """Inputs of the stage `bake`."""

    refined_mesh: RefinedMesh
    simplified_mesh: SimplifiedMesh
    up_direction: UpDirection


def _run(inputs: BakeInputs, params: BakeSection, context: Context) -> Mapping[str, Any]:
    simplified, original = inputs.simplified_mesh.load(), inputs.refined_mesh.load_in_memory("bake")
    up = inputs.up_direction.load()
    return write_baked(context.folder, simplified, original, up, params, context.progress)


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    return None if config.get(BakeSection).enabled else "is not enabled; set bake.enabled=true"


def write_baked(
    folder: Path,
    simplified: Mesh,
    original: Mesh,
    up: Up | None,
    params: BakeSection,
    progress: Progress,
) -> dict[str, Any]:
    """Bake and write baked.glb, rotated upright, and return metrics."""
    baked = bake(simplified, original, params, progress=progress)
    texture = baked.mesh.texture
    assert texture is not None
    # Scanned colours already include the lighting of the scene.
    unlit = replace(texture, materials=tuple(map(make_unlit, texture.materials)))
    write_gltf(folder / BAKED_FILE, baked.mesh.with_(texture=unlit, up=up))
    for name, data in baked.list_map_files("baked", ".glb").items():
        (folder / BAKED_MAPS).mkdir(exist_ok=True)
        (folder / BAKED_MAPS / name).write_bytes(data)
    return baked.to_dict()


STAGE = Stage(
    name="bake",
    section=BakeSection,
    inputs=BakeInputs,
    artifact=BakedMesh,
    run=_run,
    versions=make_fixed_versions(bake, compare_surfaces),
    libraries=list_installed_versions("scanloom", "open3d", "opencv", "scipy"),
    result_names=(BAKED_FILE, f"{BAKED_MAPS}/"),
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=10, seconds_per_megapixel=1, bytes=300e6),
)
