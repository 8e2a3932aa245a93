"""A hierarchy of levels as 3D Tiles, which viewers load by what they show.

Open Geospatial Consortium, "3D Tiles specification 1.1", 22-025r4, 2023.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypedDict

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError, UsageError
from stages.files.opening import content_of
from stages.files.replacing_folder import replacing_folder
from stages.files.written_by import installed_version
from stages.lod.grid import Grid, on_grid
from stages.lod.hierarchy import Hierarchy
from stages.lod.tile_glb import tile_glb
from stages.params import check as check_params
from stages.params import param, resolve
from stages.printing import by_figures, table
from stages.progress import Progress, silent
from stages.rounding import rounded_up

if TYPE_CHECKING:
    from typing_extensions import Unpack

# Raised by hand when tiles of the same levels become others.
RESULT_VERSION = 1

Tree = dict[str, Any]
Floats = NDArray[np.float64]

TILESET = "tileset.json"
_FOLDER = "tiles"
# What refuses a folder that is something else.
WHAT = "a tileset of scanloom"
# A tile with one tile below it has at most this share of its triangles; else that one stands for both.
_MOST_OF_CHILD = 0.8
# Digits of a bound, rounded up.
_DIGITS = 6
# The turns that bring an axis up, along z.
_TURNS = {
    "+x": ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    "-x": ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    "+y": ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    "-y": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
    "+z": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    "-z": ((1, 0, 0), (0, -1, 0), (0, 0, -1)),
    "none": ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
}


@dataclass(frozen=True, kw_only=True)
class TilesParams:
    """How tiles are written."""

    up: str = param(
        "-y",
        "The axis of the mesh that is up (+x, -x, +y, -y, +z, -z), or a direction, as three numbers; the "
        "tileset turns it along z, and `none` leaves it as it is. In the frame of a camera -y is up, so it "
        "is in a scan whose poses were not given.",
    )

    def __post_init__(self) -> None:
        check_params(self)
        turn_of(self.up)


def turn_of(up: str) -> Floats:
    """Return the rotation (3, 3) that brings what is up along z: an axis by name, or three numbers.

    Raises
    ------
    UsageError
        If it is neither, or the numbers are no direction.
    """
    if up in _TURNS:
        return np.array(_TURNS[up], np.float64)
    try:
        direction = np.array([float(word) for word in up.split()])
    except ValueError:
        raise UsageError(f"up is {up!r}; it must be one of {', '.join(_TURNS)}.") from None
    length = float(np.linalg.norm(direction))
    if len(direction) != 3 or not 0 < length < math.inf:
        raise UsageError(f"up is {up!r}; a direction is three numbers, not all of them 0.")
    towards = direction / length
    # What is farthest from up gives the other axes.
    across = np.cross(towards, np.eye(3)[np.argmin(np.abs(towards))])
    across /= np.linalg.norm(across)
    return np.stack([across, np.cross(towards, across), towards])


class TilesKeywords(TypedDict, total=False):
    """TilesParams as keywords of `write_tiles`."""

    up: str


@dataclass(frozen=True, eq=False)
class Tileset:
    """Tiles that were written.

    Attributes
    ----------
    grid : of the positions of all tiles.
    sizes : (k,) int64, bytes of each tile's file, the root's first.
    triangles : (k,) int64, of each tile.
    tree : what tileset.json says.
    """

    grid: Grid
    sizes: NDArray[np.int64]
    triangles: NDArray[np.int64]
    tree: Tree

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
            "one_sided": "one_sided" in self.tree["asset"]["extras"],
        }


def write_tiles(
    hierarchy: Hierarchy,
    outdir: Path | str,
    params: TilesParams | None = None,
    *,
    progress: Progress = silent,
    **changes: Unpack[TilesKeywords],
) -> Tileset:
    """Write a hierarchy as 3D Tiles 1.1: `outdir/tileset.json` and a GLB file for each tile.

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
    progress : called with (tiles written, all).

    Raises
    ------
    InputError
        If levels are missing, there is something else at `outdir`, or positions cannot be told.
    StageError
        If the system refuses to write.
    UsageError
        If a parameter is out of range.
    """
    params = resolve(TilesParams, params, changes)
    _require_whole(hierarchy)
    outdir = Path(outdir)
    with replacing_folder(outdir, is_tileset, WHAT) as draft:
        placed, grid = on_grid(hierarchy)
        (draft / _FOLDER).mkdir()
        tiles = _tiles(hierarchy, grid)
        sizes, triangles = [], []
        for done, tile in enumerate(tiles):
            mesh = placed.mesh([tile.node], [int(placed.splits[tile.node]) if tile.is_base else 0])
            content = tile_glb(mesh, grid)
            (draft / tile.uri).write_bytes(content)
            sizes.append(len(content))
            triangles.append(len(mesh.triangles))
            progress(done + 1, len(tiles))
        tree = _tileset(placed, tiles, grid, params.up)
        (draft / TILESET).write_text(json.dumps(tree, separators=(",", ":")), "utf-8")
    return Tileset(grid, np.array(sizes, np.int64), np.array(triangles, np.int64), tree)


def is_tileset(folder: Path) -> bool:
    """Return whether a folder holds a tileset that scanloom wrote, and nothing else."""
    if {entry.name for entry in folder.iterdir()} != {TILESET, _FOLDER}:
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
            raise InputError("the finest levels are missing; tiles need them all. Build the file again.")


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


def _tileset(placed: Hierarchy, tiles: list[_Tile], grid: Grid, up: str) -> Tree:
    """Return what tileset.json says."""
    low, high = placed.boxes
    described: dict[int, Tree] = {}
    own = {(tile.node, tile.is_base): tile for tile in tiles}
    # From the last node to the root, so that children are there before their parent.
    for node in range(placed.nodes - 1, -1, -1):
        box = {"box": _box(low[node], high[node], grid)}
        below = [described[int(child)] for child in placed.children[node]]
        for tile in (own.get((node, True)), own.get((node, False))):
            if tile is not None:
                below = [_described(tile, box, below, placed)]
        (described[node],) = below
    root = described[0]
    transform = np.eye(4)
    transform[:3, :3] = turn_of(up)
    transform[:3, 3] = transform[:3, :3] @ grid.origin
    moves = not np.array_equal(transform, np.eye(4))
    # Where nothing is shown, all of the model is missing.
    diagonal = float(np.linalg.norm(high[0] - low[0]))
    about: Tree = {"scanloom": installed_version()}
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


def _described(tile: _Tile, volume: Tree, below: list[Tree], hierarchy: Hierarchy) -> Tree:
    """Return what tileset.json says of a tile and those below it."""
    extras: Tree = {"shape_bound_m": tile.shape_bound}
    if hierarchy.colors is not None:
        extras["color_bound_levels"] = tile.color_bound
    if hierarchy.is_one_sided:
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
