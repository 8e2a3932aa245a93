"""The optional stage `bake`: the simplified mesh with the colours of the clean one as its texture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.standing import Up
from stages.params import param
from stages.progress import Progress
from stages.surface.formats.gltf_writer import write_gltf
from stages.surface.mesh import Mesh
from stages.texturing.bake import BakeParams, bake


@dataclass(frozen=True, kw_only=True)
class BakeSection(BakeParams):
    """Whether a run bakes a texture for the simplified mesh, and which."""

    enabled: bool = param(
        False,
        "Bake the colours of the clean mesh into a texture of the simplified one, which shows them in full.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )


def make(
    folder: Path,
    light: Mesh,
    original: Mesh,
    up: Up | None,
    params: BakeSection,
    progress: Progress,
) -> dict[str, Any]:
    """Write baked.glb, which stands by what is up, and return the figures."""
    baked = bake(light, original, params, progress=progress)
    # Colours of a scan have their light.
    write_gltf(folder / "baked.glb", baked.mesh.with_(up=up), shading="unlit")
    return baked.figures()
