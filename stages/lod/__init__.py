"""Level of detail: progressive meshes in a tree of cells, with proven bounds.

>>> from scanloom.stages import lod, read_mesh >>> hierarchy = lod.build(read_mesh("clean.ply")) >>> coarse =
hierarchy.cut(triangles=20_000) >>> coarse.mesh, coarse.shape_bound_m
"""

from scanloom.stages.lod.build import LodParams, build
from scanloom.stages.lod.evaluate import adjust, evaluate
from scanloom.stages.lod.front import Cut, Front
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.slod import read_slod, write_slod
from scanloom.stages.lod.tile_texture import TileImageParams
from scanloom.stages.lod.tiles import Tileset, TilesParams, write_tiles
from scanloom.stages.lod.view import View

__all__ = [
    "Cut",
    "Front",
    "Hierarchy",
    "LodParams",
    "TileImageParams",
    "TilesParams",
    "Tileset",
    "View",
    "adjust",
    "build",
    "evaluate",
    "read_slod",
    "write_slod",
    "write_tiles",
]
