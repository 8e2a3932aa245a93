"""The stage `tiles`: levels of detail as 3D Tiles, upright, and with the photos' colours."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from pipeline.standing import Up
from stages.lod.hierarchy import Hierarchy
from stages.lod.tile_texture import TileImageParams
from stages.lod.tiles import COMPRESSIONS, write_tiles
from stages.params import param
from stages.progress import Progress
from stages.surface.mesh import Mesh

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


def make(
    folder: Path,
    hierarchy: Hierarchy,
    model: Mesh | None,
    params: TilesSection,
    up: Up | None,
    progress: Progress,
) -> dict[str, Any]:
    """Write the folder tiles/, and return the figures.

    Parameters
    ----------
    hierarchy : the levels.
    up : what is up in the scan; None to leave it as it is.
    model : the textured mesh, whose colours tiles get; None for those of the levels.
    """
    images = TileImageParams(**{field.name: getattr(params, field.name) for field in fields(TileImageParams)})
    written = write_tiles(
        hierarchy,
        folder / FOLDER,
        texture=model,
        images=images,
        up="none" if up is None else " ".join(map(repr, up)),
        page=params.page,
        compress=params.compress,
        progress=progress,
    )
    return written.figures() | {"warnings": list(written.notes)}
