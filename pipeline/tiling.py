"""The stage `tiles`: levels of detail as 3D Tiles, upright, and with the photos' colours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from stages.lod.hierarchy import Hierarchy
from stages.lod.tile_texture import TileImageParams
from stages.lod.tiles import COMPRESSIONS, turn_of, write_tiles
from stages.params import param
from stages.picturing.viewpoints import up_of
from stages.progress import Progress
from stages.scans.scan import Frame
from stages.surface.mesh import Mesh
from stages.surface.upright import up_of_surface

# Raised by hand when the same clean mesh and frames come to another up.
RESULT_VERSION = 1

FOLDER = "tiles"


@dataclass(frozen=True, kw_only=True)
class TilesSection(TileImageParams):
    """Whether a run writes its levels of detail as 3D Tiles, and how."""

    enabled: bool = param(
        True,
        "Write 3D Tiles of the levels of detail, where there are any (lod.enabled=true).",
        # It decides whether the stage is there, not what comes out of it.
        invalidates=False,
    )
    images: bool = param(
        True,
        "Give each tile an image with the colours of textured.glb, where the run makes one; else tiles have "
        "colours of vertices.",
    )
    page: bool = param(False, "Write a page beside the tiles that draws them in a browser.")
    compress: str = param(
        "none",
        "How the geometry of tiles is packed, without loss: meshopt makes it smaller, and asks viewers for "
        "EXT_meshopt_compression; tiles that it would not make smaller stay as they are.",
        choices=COMPRESSIONS,
    )
    up: str | None = param(
        None,
        "What is up in the scan, which the tiles turn along z: an axis (+x, -x, +y, -y, +z, -z), a direction "
        "as three numbers, or `as-is`, which turns nothing. By default where most of the surface looks "
        "that is within 60° of up in the frames: floors and tops of tables.",
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.up is not None:
            turn_of(_words_of(self.up))


def make(
    folder: Path,
    hierarchy: Hierarchy,
    mesh: Mesh,
    frames: Sequence[Frame],
    model: Mesh | None,
    params: TilesSection,
    progress: Progress,
) -> dict[str, Any]:
    """Write the folder tiles/, and return the figures.

    Parameters
    ----------
    hierarchy : the levels.
    mesh, frames : the clean mesh, and frames with poses, which tell what is up.
    model : the textured mesh, whose colours tiles get; None for those of the levels.
    """
    up, source = _up(mesh, frames) if params.up is None else (_words_of(params.up), "given")
    images = TileImageParams(**{field.name: getattr(params, field.name) for field in fields(TileImageParams)})
    written = write_tiles(
        hierarchy,
        folder / FOLDER,
        texture=model,
        images=images,
        up=up,
        page=params.page,
        compress=params.compress,
        progress=progress,
    )
    return written.figures() | {"up": up, "up_source": source, "warnings": list(written.notes)}


def _words_of(up: str) -> str:
    # In a configuration `none` gives a parameter back to being derived.
    return "none" if up == "as-is" else up


def _up(mesh: Mesh, frames: Sequence[Frame]) -> tuple[str, str]:
    """Return what is up as three numbers, and what tells it."""
    poses = np.array([frame.world_from_camera for frame in frames if frame.world_from_camera is not None])
    held = up_of(poses)
    found = up_of_surface(mesh, held)
    words = " ".join(f"{value:.6g}" for value in (held if found is None else found))
    return words, "frames" if found is None else "surface"
