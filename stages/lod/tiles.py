"""A hierarchy of levels as 3D Tiles, which viewers load by what they show.

Open Geospatial Consortium, "3D Tiles specification 1.1", 22-025r4, 2023.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.opening import content_of
from scanloom.stages.files.replacing_folder import replacing_folder
from scanloom.stages.files.written_by import installed_version
from scanloom.stages.lod.codes import LEVELS_CUT_OFF, LEVELS_LEFT_OUT
from scanloom.stages.lod.grid import Grid, on_grid
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.tile_glb import tile_glb
from scanloom.stages.lod.tile_texture import (
    Piece,
    TileImage,
    TileImageParams,
    figures_of,
    model_of,
    with_images,
)
from scanloom.stages.params import check as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.picturing.page.files import FOLDER as PAGE_FOLDER
from scanloom.stages.picturing.page.files import INDEX, tiles_page
from scanloom.stages.picturing.page.standing import facing
from scanloom.stages.printing import by_figures, table
from scanloom.stages.printing.rounding import rounded_up
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.color import is_transparent
from scanloom.stages.surface.convert import MeshLike, as_mesh
from scanloom.stages.surface.finite import require_finite
from scanloom.stages.surface.mesh import NOT_WRITTEN, Mesh
from scanloom.stages.surface.upright import direction_of, turn_along_z

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import TilesKeywords

# Raised by hand when tiles of the same levels become others.
RESULT_VERSION = 1

Tree = dict[str, Any]
Floats = NDArray[np.float64]

TILESET = "tileset.json"
_FOLDER = "tiles"
COMPRESSIONS = ("none", "meshopt")
# What refuses a folder that is something else.
WHAT = "a tileset of scanloom"
# A tile with one tile below it has at most this share of its triangles; else that one stands for both.
_MOST_OF_CHILD = 0.8
# Up in the frame of a camera, and so in a scan whose poses were not given.
_OF_CAMERAS = "-y"
# Digits of a bound, rounded up.
_DIGITS = 6


@dataclass(frozen=True, kw_only=True)
class TilesParams:
    """How tiles are written."""

    up: str | None = param(
        None,
        "The axis of the mesh that is up (+x, -x, +y, -y, +z, -z), or a direction, as three numbers; the "
        "tileset turns it along z, and `none` leaves it as it is. By default what the file says, or that of "
        "the texture; where neither says it -y, which is up in the frame of a camera.",
    )
    page: bool = param(
        False,
        "Write a page beside the tiles, index.html and what it needs, that draws them in a browser.",
        common=True,
    )
    compress: str = param(
        "none",
        "How the geometry of tiles is packed, without loss: meshopt makes it smaller, and asks viewers for "
        "EXT_meshopt_compression; tiles that it would not make smaller stay as they are.",
        choices=COMPRESSIONS,
    )

    def __post_init__(self) -> None:
        check_params(self)
        if self.up is not None:
            direction_of(self.up)


@dataclass(frozen=True, eq=False)
class Tileset:
    """Tiles that were written.

    Attributes
    ----------
    grid : of the positions of all tiles.
    sizes : (k,) int64, bytes of each tile's file, the root's first.
    triangles : (k,) int64, of each tile.
    tree : what tileset.json says.
    up : (3,) what is up in the levels, and is turned along z; None where they stay as they are.
    images : of each tile; none where tiles have vertex colours.
    diagnostics : what was left out.
    """

    grid: Grid
    sizes: NDArray[np.int64]
    triangles: NDArray[np.int64]
    tree: Tree
    up: tuple[float, float, float] | None
    images: tuple[TileImage, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return how many and how large they are."""
        return {
            "tiles": len(self.sizes),
            "triangles": int(self.triangles.sum()),
            "total_bytes": int(self.sizes.sum()),
            "root_bytes": int(self.sizes[0]),
            "median_bytes": int(np.median(self.sizes)),
            "largest_bytes": int(self.sizes.max()),
            "positions": "16 bits" if self.grid.in_16_bits else "single precision",
            "grid_step_m": self.grid.step,
            "grid_share_m": self.grid.share_m,
            "geometric_error_m": float(self.tree["root"]["geometricError"]),
            "up": self.up,
            "images": figures_of(self.images) if self.images else None,
            "one_sided": "one_sided" in self.tree["asset"]["extras"],
        }


def write_tiles(
    hierarchy: Hierarchy,
    outdir: Path | str,
    params: TilesParams | None = None,
    *,
    texture: MeshLike | None = None,
    images: TileImageParams | None = None,
    progress: Progress = silent,
    **changes: Unpack[TilesKeywords],
) -> Tileset:
    """Write a hierarchy as 3D Tiles 1.1: `outdir/tileset.json` and a GLB file for each tile.

    With `page`, `outdir/index.html` and `outdir/page/` draw them in a browser. They have to be served: a page
    that is opened as a file may not load others.

    A tile is a node's coarse mesh; below each leaf there is one tile more, the mesh the hierarchy was built
    on. A tile's children take its place as one; where it has one child, with hardly more triangles, it is
    left out. Tiles of any levels fit without cracks, as nodes do: all positions lie on one grid.

    The `geometricError` of a tile is what is proven of its shape, both ways and at every point, and how far
    the grid moves it, in metres, rounded up; never less than a child's. The `extras` of its content say the
    same of itself, `shape_bound_m`, and what is proven of its colours, `color_bound_levels`, as displayed
    values that change evenly over each triangle. Where islands were dropped, all this is one-sided, and the
    `extras` of each content and of the tileset say so.

    Parameters
    ----------
    hierarchy : with all of its levels.
    outdir : a folder that is made; a tileset of scanloom that is there is replaced, whole or not at all.
    params : TilesParams; single fields can be given by name instead.
    texture : a mesh of the same surface, with an image or vertex colours, in the same place: the one the
        levels were built from, or what was textured since; if not given `hierarchy.model`, where there is
        one. Each tile gets an image of its own with its colours, in place of vertex colours; its positions
        and triangles are the same as without. In the `extras` of its content, what is sampled of its colours
        takes the place of `color_bound_levels`.
    images : how these are.
    progress : called with (tiles written, all).

    Raises
    ------
    InputError
        If levels are missing, there is something else at `outdir`, or positions cannot be told.
    MeshError
        If `texture` is no valid mesh, has no colours or is of another surface, or a tile is in too many
        pieces for an image.
    StageError
        If the system refuses to write.
    UsageError
        If a parameter is out of range.
    """
    with collecting() as diagnostics:
        params = resolve(TilesParams, params, changes)
        tiles = _write_tiles(hierarchy, Path(outdir), params, texture, images, progress)
    return replace(tiles, diagnostics=tuple(diagnostics))


def _write_tiles(
    hierarchy: Hierarchy,
    outdir: Path,
    params: TilesParams,
    texture: MeshLike | None,
    images: TileImageParams | None,
    progress: Progress,
) -> Tileset:
    _require_whole(hierarchy)
    require_finite([("vertex", hierarchy.vertices)], outdir, NOT_WRITTEN)
    model = hierarchy.model if texture is None else as_mesh(texture, "model")
    with replacing_folder(outdir, is_tileset, WHAT) as draft:
        placed, grid = on_grid(hierarchy)
        (draft / _FOLDER).mkdir()
        tiles = _tiles(hierarchy, grid)
        sizes, triangles = np.zeros((2, len(tiles)), np.int64)
        found: dict[int, TileImage] = {}
        for done, (number, mesh, image) in enumerate(_meshes(placed, tiles, grid, model, images)):
            # A tiny tile is smaller as it is: how its buffers are packed takes words.
            ways = (False, True) if params.compress == "meshopt" else (False,)
            content = min((tile_glb(mesh, grid, pack=pack) for pack in ways), key=len)
            (draft / tiles[number].uri).write_bytes(content)
            sizes[number], triangles[number] = len(content), len(mesh.triangles)
            if image is not None:
                found[number] = image
            progress(done + 1, len(tiles))
        of_tiles = tuple(found[number] for number in sorted(found))
        up = _up(params, hierarchy, model)
        tree = _tileset(placed, tiles, of_tiles, grid, up)
        (draft / TILESET).write_text(json.dumps(tree, separators=(",", ":")), encoding="utf-8", newline="\n")
        for name, content in (tiles_page() if params.page else {}).items():
            (draft / name).parent.mkdir(parents=True, exist_ok=True)
            (draft / name).write_bytes(content)
    if model is not None and is_transparent(model):
        emit(LEVELS_LEFT_OUT.warning("tiles left out: the transparency of the model's images."))
    told = None if up is None else (float(up[0]), float(up[1]), float(up[2]))
    return Tileset(grid, sizes, triangles, tree, told, of_tiles)


def _up(params: TilesParams, hierarchy: Hierarchy, model: Mesh | None) -> Floats | None:
    """Return what is up, (3,) of length 1; None to turn nothing."""
    if params.up is not None:
        return direction_of(params.up)
    known = hierarchy.up if model is None or hierarchy.up is not None else model.up
    return direction_of(_OF_CAMERAS) if known is None else np.array(known)


def is_tileset(folder: Path) -> bool:
    """Return whether a folder holds a tileset that scanloom wrote, and nothing else."""
    found, own = {entry.name for entry in folder.iterdir()}, {TILESET, _FOLDER}
    if found not in (own, own | {INDEX, PAGE_FOLDER}):
        return False
    try:
        tree = json.loads(content_of(folder / TILESET))
        return "scanloom" in tree["asset"]["extras"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _require_whole(h: Hierarchy) -> None:
    for node, children in enumerate(h.children):
        below = int(h.coarse[children].sum())
        if below != h.full[node] if len(children) else h.level[node] > 0:
            raise InputError(
                LEVELS_CUT_OFF,
                "the finest levels are missing; tiles need them all.",
                remedy="Build the file again.",
            )


@dataclass(frozen=True)
class _Tile:
    """A tile: a node's coarse mesh, or at a leaf the base, and what is proven of that."""

    node: int
    is_base: bool
    uri: str
    shape_bound: float
    color_bound: float


def _tiles(h: Hierarchy, grid: Grid) -> list[_Tile]:
    """Return all tiles: those of nodes, by their numbers, then those below leaves."""

    def tile(node: int, is_base: bool, shape: float, color: float) -> _Tile:
        bound = rounded_up(math.nextafter(shape + grid.share_m, math.inf), _DIGITS)
        uri = f"{_FOLDER}/{node}{'-base' if is_base else ''}.glb"
        return _Tile(node, is_base, uri, bound, color)

    found, base = [], []
    for node, children in enumerate(h.children):
        if len(children) > 1 or h.coarse[node] <= _MOST_OF_CHILD * h.full[node]:
            found.append(tile(node, False, float(h.shape_bound[node]), float(h.color_bound[node])))
        if not len(children):
            base.append(tile(node, True, h.base_shape_bound, h.base_color_bound))
    return found + base


def _meshes(
    placed: Hierarchy,
    tiles: list[_Tile],
    grid: Grid,
    textured: Mesh | None,
    params: TileImageParams | None,
) -> Iterator[tuple[int, Mesh, TileImage | None]]:
    """Give the number of each tile, its mesh, and its image if it is to have one."""

    def mesh_of(tile: _Tile) -> Mesh:
        return placed.mesh([tile.node], [int(placed.splits[tile.node]) if tile.is_base else 0])

    if textured is None:
        for number, tile in enumerate(tiles):
            yield number, mesh_of(tile), None
        return
    model = model_of(textured, placed.mesh(leaves := _leaves(placed), placed.splits[leaves]), grid.origin)
    pieces = [
        Piece(mesh_of(tile).with_(colors=None), tile.shape_bound, below)
        for tile, below in zip(tiles, _below(placed, tiles), strict=True)
    ]
    yield from with_images(pieces, model, params or TileImageParams())


def _leaves(h: Hierarchy) -> NDArray[np.int64]:
    return np.flatnonzero([not len(children) for children in h.children])


def _below(h: Hierarchy, tiles: list[_Tile]) -> list[tuple[int, ...]]:
    """Return for each tile those of the levels below its own that are together all of the surface."""
    number_of = {(tile.node, tile.is_base): number for number, tile in enumerate(tiles)}

    def standing_for(node: int) -> int:
        while (node, False) not in number_of and len(h.children[node]):
            (node,) = h.children[node].tolist()
        return number_of.get((node, False), number_of.get((node, True), -1))

    def front(level: int) -> tuple[int, ...]:
        todo, found = [0], []
        while todo:
            node = todo.pop()
            if h.level[node] < level:
                found.append(standing_for(node))
            elif len(h.children[node]):
                todo += h.children[node].tolist()
            else:
                found.append(number_of[node, True])
        return tuple(sorted(found))

    fronts = {level: front(level) for level in set(h.level.tolist())}
    return [() if tile.is_base else fronts[int(h.level[tile.node])] for tile in tiles]


def _tileset(
    placed: Hierarchy, tiles: list[_Tile], images: Sequence[TileImage], grid: Grid, up: Floats | None
) -> Tree:
    """Return what tileset.json says."""
    low, high = placed.boxes
    described: dict[int, Tree] = {}
    own = {(tile.node, tile.is_base): tile for tile in tiles}
    shown = {tile.uri: image for tile, image in zip(tiles, images, strict=False)}
    # From the last node to the root, so that children are there before their parent.
    for node in range(placed.nodes - 1, -1, -1):
        box = {"box": _box(low[node], high[node], grid)}
        below = [described[int(child)] for child in placed.children[node]]
        for tile in (own.get((node, True)), own.get((node, False))):
            if tile is not None:
                colors = {} if placed.colors is None else {"color_bound_levels": tile.color_bound}
                if tile.uri in shown:
                    colors = shown[tile.uri].figures()
                below = [_described(tile, box, below, colors, placed.is_one_sided)]
        (described[node],) = below
    root = described[0]
    transform = np.eye(4)
    transform[:3, :3] = turn_along_z(up)
    transform[:3, 3] = transform[:3, :3] @ grid.origin
    moves = not np.array_equal(transform, np.eye(4))
    # Where nothing is shown, all of the model is missing.
    diagonal = float(np.linalg.norm(high[0] - low[0]))
    about: Tree = {"scanloom": installed_version()}
    look = facing(placed.mesh([0], [0]), turn_along_z(up))
    if look is not None:
        about["facing"] = look
    if placed.is_one_sided:
        about |= {
            "one_sided": True,
            "dropped_islands": placed.dropped_islands,
            "dropped_triangles": placed.dropped_triangles,
        }
    return {
        "asset": {"version": "1.1", "extras": about},
        "geometricError": max(diagonal, root["geometricError"]),
        "root": {
            **({"transform": transform.T.reshape(-1).tolist()} if moves else {}),
            "refine": "REPLACE",
            **root,
        },
    }


def _described(tile: _Tile, volume: Tree, below: list[Tree], colors: Tree, is_one_sided: bool) -> Tree:
    """Return what tileset.json says of a tile, of its colours, and of those below it."""
    extras: Tree = {"shape_bound_m": tile.shape_bound, **colors}
    if is_one_sided:
        extras["one_sided"] = True
    return {
        "boundingVolume": volume,
        "geometricError": max([tile.shape_bound, *(child["geometricError"] for child in below)]),
        "content": {"uri": tile.uri, "extras": extras},
        **({"children": below} if below else {}),
    }


def _box(low: Floats, high: Floats, grid: Grid) -> list[float]:
    """Return a box, a step wider on all sides, as its middle and its half axes.

    So a flat one has a thickness, and all stay one in the other: on the grid these sums are exact.
    """
    half = 0.5 * (high - low) + grid.step
    return [*(0.5 * (low + high)).tolist(), *np.diag(half).reshape(-1).tolist()]
