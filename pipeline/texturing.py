"""The stage `texture`: the simplified mesh with what the photos saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stages.params import param
from stages.progress import Progress
from stages.scans.scan import Frame
from stages.surface.mesh import Mesh
from stages.surface.mesh_files import write_mesh
from stages.texturing.texture import TextureParams, texture

FILE = "textured.glb"


@dataclass(frozen=True, kw_only=True)
class TextureSection(TextureParams):
    """Whether a run gives the simplified mesh a texture from the photos, and which."""

    enabled: bool = param(
        True,
        "Give the simplified mesh what the photos show, wherever frames have colour.",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )
    images: str | None = param(
        None,
        "Folder of other photos with poses in the scan's world, in metres (COLMAP, nerfstudio, or any scan): "
        "their colours are taken, and none of the frames'.",
        # What is in the folder decides, not its name.
        invalidates=False,
    )


def make(
    folder: Path, mesh: Mesh, frames: Sequence[Frame], params: TextureSection, progress: Progress
) -> dict[str, Any]:
    """Write textured.glb and return the figures."""
    textured = texture(mesh, frames, params, progress=progress)
    write_mesh(folder / FILE, textured.mesh)
    return textured.figures()
