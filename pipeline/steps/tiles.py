"""Stage `tiles`: writes levels of detail as 3D Tiles.

Tiles are upright and have the colours of the photos.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from scanloom.pipeline.artifacts.up_direction import Up, UpDirection
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.report.page.tileset_page import write_tileset_page
from scanloom.pipeline.result_versions import make_fixed_versions
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import Artifact, Context, Stage
from scanloom.pipeline.steps.lod import Levels, LodSection
from scanloom.pipeline.steps.texture import TexturedMesh
from scanloom.stages.inspecting.libraries import list_installed_versions
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.tile_texture import TileImageParams
from scanloom.stages.lod.tiles import COMPRESSIONS, write_tiles
from scanloom.stages.params import param
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.surface.mesh import Mesh

TILES_FOLDER = "tiles"


@dataclass(frozen=True, kw_only=True)
class TilesSection(TileImageParams):
    """3D Tiles of the levels of detail."""

    enabled: bool = param(
        True,
        "Write the levels of detail as 3D Tiles, if there are any (lod.enabled=true).",
        # Only decides if the stage runs, so the cache key ignores it.
        invalidates=False,
        common=True,
    )
    images: bool = param(
        True,
        "Texture each tile with the colours of textured.glb, if the run writes one; otherwise tiles have "
        "vertex colours.",
    )
    page: bool = param(False, "Write a page next to the tiles that shows them in a browser.", common=True)
    compress: str = param(
        "none",
        "Lossless compression of the geometry of tiles. `meshopt` requires viewers that support "
        "EXT_meshopt_compression; tiles that it would not reduce are left uncompressed.",
        choices=COMPRESSIONS,
    )


@dataclass(frozen=True)
class Tileset(Artifact):
    """Tileset in the format 3D Tiles."""

    NAME = "tileset"


@dataclass(frozen=True, kw_only=True)
class TilesInputs:
    """Inputs of the stage `tiles`.

    Attributes
    ----------
    textured_mesh : source of the tile images.
    """

    up_direction: UpDirection
    levels: Levels
    textured_mesh: TexturedMesh | None = None


def _run(inputs: TilesInputs, params: TilesSection, context: Context) -> Mapping[str, Any]:
    textured = None if inputs.textured_mesh is None else inputs.textured_mesh.load()
    up = inputs.up_direction.load()
    return write_tileset(context.folder, inputs.levels.load(), textured, params, up, context.progress)


def _list_ignored_inputs(config: Sections) -> Collection[str]:
    return () if config.get(TilesSection).images else ("textured_mesh",)


def _get_skip_reason(scan: Scan, config: Sections) -> str | None:  # noqa: ARG001
    if not config.get(TilesSection).enabled:
        return "is switched off; set tiles.enabled=true"
    if not config.get(LodSection).enabled:
        return "needs levels of detail, which are not enabled; set lod.enabled=true"
    return None


def write_tileset(
    folder: Path,
    hierarchy: Hierarchy,
    textured_mesh: Mesh | None,
    params: TilesSection,
    up: Up | None,
    progress: Progress,
) -> dict[str, Any]:
    """Write the folder tiles/ and return metrics.

    Parameters
    ----------
    hierarchy : levels of detail.
    textured_mesh : textured mesh that colours the tiles; None to use the vertex colours of the levels.
    up : up direction of the scan; None to write tiles without rotation.
    """
    images = TileImageParams(**{field.name: getattr(params, field.name) for field in fields(TileImageParams)})
    written = write_tiles(
        hierarchy,
        folder / TILES_FOLDER,
        texture=textured_mesh,
        images=images,
        up="none" if up is None else " ".join(map(repr, up)),
        compress=params.compress,
        progress=progress,
    )
    if params.page:
        write_tileset_page(folder / TILES_FOLDER)
    return written.to_dict()


STAGE = Stage(
    name="tiles",
    section=TilesSection,
    inputs=TilesInputs,
    artifact=Tileset,
    run=_run,
    versions=make_fixed_versions(write_tiles),
    libraries=list_installed_versions("scanloom", "opencv", "open3d", "scipy"),
    result_names=(f"{TILES_FOLDER}/",),
    ignored_inputs=_list_ignored_inputs,
    skip_reason=_get_skip_reason,
    cost=CostModel(seconds=10, seconds_per_megapixel=1, bytes=700e6, bytes_per_megapixel=10e6),
    headline="{tiles:,} tiles; {total_bytes:,} bytes, the root {root_bytes:,}",
    progress_unit="tiles",
)
