"""Export of a hierarchy as 3D Tiles, which viewers load depending on the view.

Source: Open Geospatial Consortium, "3D Tiles specification 1.1", 22-025r4, 2023.
"""

from __future__ import annotations

import json
import math
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.atomic_folders import write_folder_atomically
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.version import get_installed_version
from scanloom.stages.lod.codes import LEVELS_CUT_OFF, LEVELS_LEFT_OUT
from scanloom.stages.lod.hierarchy import Hierarchy
from scanloom.stages.lod.position_grid import PositionGrid, snap_to_grid
from scanloom.stages.lod.tile_glb import encode_tile_glb
from scanloom.stages.lod.tile_texture import (
    TileImage,
    TileImageParams,
    TileMesh,
    paint_tile_images,
    prepare_color_source,
    summarize_images,
)
from scanloom.stages.params import check_parameters as check_params
from scanloom.stages.params import param, resolve
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.printing.rounding import round_up
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.finite_check import require_finite
from scanloom.stages.surface.mean_normal import estimate_mean_normal
from scanloom.stages.surface.mesh import WRITING_REMEDY, Mesh
from scanloom.stages.surface.mesh_conversion import MeshLike, as_mesh
from scanloom.stages.surface.surface_color import is_transparent
from scanloom.stages.surface.up_direction import parse_up_direction, rotate_to_z

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import TilesKeywords

# Increment when the tiles of the same levels change, to invalidate cache entries.
RESULT_VERSION = 3

Tree = dict[str, Any]
Floats = NDArray[np.float64]

TILESET = "tileset.json"
_TILES_FOLDER = "tiles"
# Files of the viewer page, which the command may add to the tileset folder.
PAGE_INDEX, PAGE_FOLDER = "index.html", "page"
COMPRESSIONS = ("none", "meshopt")
# Description of the expected content, for the error if the output folder contains something else.
TILESET_DESCRIPTION = "a tileset of scanloom"
# Maximum triangles of a tile relative to its only child; a larger tile is skipped, and the child replaces it.
_MAX_CHILD_RATIO = 0.8
# Maximum bytes of a tile of the base mesh, without compression and image. A larger base mesh is split. Tiles
# of coarser levels cannot be split: their children replace them together.
_MAX_BASE_BYTES = 80_000
# Up axis in camera coordinates, which are the world coordinates of scans without given poses.
_CAMERA_UP = "-y"
# Significant digits of a bound, rounded up.
_BOUND_DIGITS = 6


@dataclass(frozen=True, kw_only=True)
class TilesParams:
    """Parameters of writing tiles."""

    up: str | None = param(
        None,
        "Up axis of the mesh (+x, -x, +y, -y, +z, -z), or a direction as three numbers. The tileset rotates "
        "it to z; `none` keeps the orientation. Default: the up direction stored in the file or with the "
        "texture, else -y, which is up in camera coordinates.",
    )
    compress: str = param(
        "none",
        "Lossless compression of the geometry. With meshopt, viewers must support EXT_meshopt_compression; "
        "tiles that it does not make smaller stay uncompressed.",
        choices=COMPRESSIONS,
    )

    def __post_init__(self) -> None:
        check_params(self)
        if self.up is not None:
            parse_up_direction(self.up)


@dataclass(frozen=True, eq=False)
class Tileset:
    """Written tileset.

    Attributes
    ----------
    grid : position grid of all tiles.
    sizes : (k,) int64, file size of each tile in bytes, root first.
    triangles : (k,) int64, number of triangles of each tile.
    tree : content of tileset.json.
    up : (3,) up direction of the levels, which the tileset rotates to z; None if nothing is rotated.
    images : image metrics of each tile; empty if tiles have vertex colours.
    diagnostics : warnings, such as dropped attributes.
    """

    grid: PositionGrid
    sizes: NDArray[np.int64]
    triangles: NDArray[np.int64]
    tree: Tree
    up: tuple[float, float, float] | None
    images: tuple[TileImage, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return counts and sizes for JSON, with units in the keys."""
        return {
            "tiles": len(self.sizes),
            "triangles": int(self.triangles.sum()),
            "total_bytes": int(self.sizes.sum()),
            "root_bytes": int(self.sizes[0]),
            "median_bytes": int(np.median(self.sizes)),
            "largest_bytes": int(self.sizes.max()),
            "positions": "16 bits" if self.grid.in_16_bits else "single precision",
            "grid_step_m": self.grid.step,
            "grid_displacement_m": self.grid.max_displacement_m,
            "geometric_error_m": float(self.tree["root"]["geometricError"]),
            "up": self.up,
            "images": summarize_images(self.images) if self.images else None,
            "one_sided": "one_sided" in self.tree["asset"]["extras"],
        }


def write_tiles(
    hierarchy: Hierarchy,
    outdir: Path | str,
    params: TilesParams | None = None,
    *,
    texture: MeshLike | None = None,
    images: TileImageParams | None = None,
    progress: Progress = ignore_progress,
    **changes: Unpack[TilesKeywords],
) -> Tileset:
    """Write a hierarchy as 3D Tiles 1.1.

    The output is `outdir/tileset.json` and one GLB file per tile. A tile is the coarse mesh of a node; below
    each leaf, the tiles are parts of the base mesh, of at most 80 kB. The children of a tile replace it
    together. A tile with a single child and hardly more triangles is skipped. Tiles of different
    levels fit without cracks, because all positions are on one grid.

    The `geometricError` of a tile is its proven two-sided shape bound plus the displacement by the grid, in
    metres, rounded up, and at least the error of each child. The `extras` of its content contain the tile's
    own bounds: `shape_bound_m`, and `color_bound_levels` for colours interpolated as displayed values. If
    small components were dropped, the bounds are one-sided, and the `extras` of each content and of the
    tileset say so.

    Parameters
    ----------
    hierarchy : complete hierarchy.
    outdir : output folder; an existing scanloom tileset is replaced atomically.
    params : TilesParams; single parameters can be given by keyword instead.
    texture : mesh of the same surface in the same coordinates, with an image or vertex colours: the source of
        the levels, or a mesh textured later. The default is `hierarchy.model`, if there is one. Each tile
        gets an image instead of vertex colours; positions and triangles stay the same. In the `extras` of its
        content, sampled colour errors replace `color_bound_levels`.
    images : parameters of these images.
    progress : called with the number of written tiles and their total.

    Returns
    -------
    Tileset

    Raises
    ------
    InputError
        If levels are missing, `outdir` contains something else, or positions do not fit the grid.
    MeshError
        If `texture` is invalid, has no colours or is another surface, or a tile has too many charts for an
        image.
    StageError
        If the files cannot be written.
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
    _require_complete(hierarchy)
    require_finite([("vertex", hierarchy.vertices)], outdir, WRITING_REMEDY)
    model = hierarchy.model if texture is None else as_mesh(texture, "model")
    with write_folder_atomically(outdir, is_tileset, TILESET_DESCRIPTION) as draft:
        snapped, grid = snap_to_grid(hierarchy)
        (draft / _TILES_FOLDER).mkdir()
        tiles = _list_tiles(snapped, grid)
        sizes, triangles = np.zeros((2, len(tiles)), np.int64)
        boxes: dict[str, tuple[Floats, Floats]] = {}
        images_by_tile: dict[int, TileImage] = {}
        for done, (number, mesh, image) in enumerate(_iterate_meshes(snapped, tiles, grid, model, images)):
            # Compression metadata makes tiny tiles larger, so keep the smaller file.
            pack_options = (False, True) if params.compress == "meshopt" else (False,)
            content = min((encode_tile_glb(mesh, grid, compress=pack) for pack in pack_options), key=len)
            (draft / tiles[number].uri).write_bytes(content)
            sizes[number], triangles[number] = len(content), len(mesh.triangles)
            boxes[tiles[number].uri] = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
            if image is not None:
                images_by_tile[number] = image
            progress(done + 1, len(tiles))
        tile_images = tuple(images_by_tile[number] for number in sorted(images_by_tile))
        up = _resolve_up(params, hierarchy, model)
        tree = _build_tileset(snapped, tiles, boxes, tile_images, grid, up)
        (draft / TILESET).write_text(json.dumps(tree, separators=(",", ":")), encoding="utf-8", newline="\n")
    if model is not None and is_transparent(model):
        emit(LEVELS_LEFT_OUT.warning("tiles drop the transparency of the model's images."))
    up_direction = None if up is None else (float(up[0]), float(up[1]), float(up[2]))
    return Tileset(grid, sizes, triangles, tree, up_direction, tile_images)


def _resolve_up(params: TilesParams, hierarchy: Hierarchy, model: Mesh | None) -> Floats | None:
    """Return the up direction (3,), unit length; None to rotate nothing."""
    if params.up is not None:
        return parse_up_direction(params.up)
    up_direction = hierarchy.up if model is None or hierarchy.up is not None else model.up
    return parse_up_direction(_CAMERA_UP) if up_direction is None else np.array(up_direction)


def is_tileset(folder: Path) -> bool:
    """Return True if a folder contains only a scanloom tileset, with or without its page."""
    found, own = {entry.name for entry in folder.iterdir()}, {TILESET, _TILES_FOLDER}
    # An interrupted command may leave an incomplete page.
    if not own <= found <= own | {PAGE_INDEX, PAGE_FOLDER}:
        return False
    try:
        tree = json.loads(read_input_bytes(folder / TILESET))
        return "scanloom" in tree["asset"]["extras"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return False


def _require_complete(h: Hierarchy) -> None:
    for node, children in enumerate(h.children):
        below = int(h.coarse[children].sum())
        if below != h.full[node] if len(children) else h.level[node] > 0:
            raise InputError(
                LEVELS_CUT_OFF,
                "the finest levels are missing; tiles require all levels.",
                remedy="Build the file again.",
            )


@dataclass(frozen=True)
class _Tile:
    """Tile of a tileset: coarse mesh of a node, or part of the base mesh below a leaf."""

    node: int
    is_base: bool
    part: int
    part_count: int
    uri: str
    shape_bound: float
    color_bound: float


def _list_tiles(h: Hierarchy, grid: PositionGrid) -> list[_Tile]:
    """List all tiles of a snapped hierarchy: nodes by index, then the base tiles below leaves."""

    def make_tile(node: int, is_base: bool, part: int, count: int, shape: float, color: float) -> _Tile:
        bound = round_up(math.nextafter(shape + grid.max_displacement_m, math.inf), _BOUND_DIGITS)
        name = f"{node}-base" if is_base else str(node)
        uri = f"{_TILES_FOLDER}/{name}{f'-{part}' if count > 1 else ''}.glb"
        return _Tile(node, is_base, part, count, uri, bound, color)

    found, base = [], []
    for node, children in enumerate(h.children):
        part_count = 0 if len(children) else _count_base_parts(_get_base_mesh(h, node), grid)
        is_light = h.coarse[node] <= _MAX_CHILD_RATIO * h.full[node]
        if len(children) > 1 or part_count > 1 or is_light:
            found.append(make_tile(node, False, 0, 1, float(h.shape_bound[node]), float(h.color_bound[node])))
        base += [
            make_tile(node, True, part, part_count, h.base_shape_bound, h.base_color_bound)
            for part in range(part_count)
        ]
    return found + base


def _iterate_meshes(
    snapped: Hierarchy,
    tiles: list[_Tile],
    grid: PositionGrid,
    source_mesh: Mesh | None,
    params: TileImageParams | None,
) -> Iterator[tuple[int, Mesh, TileImage | None]]:
    """Yield index, mesh and image metrics of each tile; None without an image."""

    @lru_cache(maxsize=1)
    def assemble_base(node: int, part_count: int) -> list[Mesh]:
        return _split_mesh(_get_base_mesh(snapped, node), part_count)

    def assemble_mesh(tile: _Tile) -> Mesh:
        if tile.is_base:
            return assemble_base(tile.node, tile.part_count)[tile.part]
        return snapped.mesh([tile.node], [0])

    if source_mesh is None:
        for number, tile in enumerate(tiles):
            yield number, assemble_mesh(tile), None
        return
    color_source = prepare_color_source(
        source_mesh, snapped.mesh(leaves := _list_leaves(snapped), snapped.splits[leaves]), grid.origin
    )
    tile_meshes = [
        TileMesh(assemble_mesh(tile).with_(colors=None), tile.shape_bound, finer_tiles)
        for tile, finer_tiles in zip(tiles, _list_finer_tiles(snapped, tiles), strict=True)
    ]
    yield from paint_tile_images(tile_meshes, color_source, params or TileImageParams())


def _get_base_mesh(snapped: Hierarchy, leaf: int) -> Mesh:
    return snapped.mesh([leaf], [int(snapped.splits[leaf])])


def _count_base_parts(mesh: Mesh, grid: PositionGrid) -> int:
    """Count the parts into which a base mesh is split, so that no tile exceeds the limit of bytes."""
    count = -(-len(encode_tile_glb(mesh, grid)) // _MAX_BASE_BYTES)
    # Parts repeat the vertices along cuts, so that more of them may be needed.
    while any(len(encode_tile_glb(part, grid)) > _MAX_BASE_BYTES for part in _split_mesh(mesh, count)):
        count += 1
    return count


def _split_mesh(mesh: Mesh, part_count: int) -> list[Mesh]:
    """Split a mesh into compact parts of about equal triangle counts, by halving the longest extent."""
    if part_count <= 1:
        return [mesh]
    centers = mesh.vertices[mesh.triangles].mean(axis=1)
    axis = int(np.argmax(np.ptp(centers, axis=0)))
    order = np.argsort(centers[:, axis], kind="stable")
    end = len(order) * (part_count // 2) // part_count
    halves = ((order[:end], part_count // 2), (order[end:], part_count - part_count // 2))
    return [part for rows, count in halves for part in _split_mesh(_take_triangles(mesh, rows), count)]


def _take_triangles(mesh: Mesh, rows: NDArray[np.int64]) -> Mesh:
    used, triangles = np.unique(mesh.triangles[np.sort(rows)], return_inverse=True)
    colors = None if mesh.colors is None else mesh.colors[used]
    return Mesh(mesh.vertices[used], triangles.reshape(-1, 3).astype(np.int32), colors=colors, up=mesh.up)


def _list_leaves(h: Hierarchy) -> NDArray[np.int64]:
    return np.flatnonzero([not len(children) for children in h.children])


def _list_finer_tiles(h: Hierarchy, tiles: list[_Tile]) -> list[tuple[int, ...]]:
    """List the source tiles of each tile: the next finer level, covering the whole surface."""
    numbers_of: defaultdict[tuple[int, bool], list[int]] = defaultdict(list)
    for number, tile in enumerate(tiles):
        numbers_of[tile.node, tile.is_base].append(number)

    def find_representatives(node: int) -> list[int]:
        while (node, False) not in numbers_of and len(h.children[node]):
            (node,) = h.children[node].tolist()
        return numbers_of.get((node, False)) or numbers_of[node, True]

    def list_front(level: int) -> tuple[int, ...]:
        todo, found = [0], []
        while todo:
            node = todo.pop()
            if h.level[node] < level:
                found += find_representatives(node)
            elif len(h.children[node]):
                todo += h.children[node].tolist()
            else:
                found += numbers_of[node, True]
        return tuple(sorted(found))

    fronts = {level: list_front(level) for level in set(h.level.tolist())}
    return [() if tile.is_base else fronts[int(h.level[tile.node])] for tile in tiles]


def _build_tileset(
    snapped: Hierarchy,
    tiles: list[_Tile],
    boxes: Mapping[str, tuple[Floats, Floats]],
    images: Sequence[TileImage],
    grid: PositionGrid,
    up: Floats | None,
) -> Tree:
    """Build the content of tileset.json.

    Parameters
    ----------
    boxes : minimum and maximum corners of the mesh of each tile, by URI.
    """
    low, high = snapped.boxes
    entries: dict[int, Tree] = {}
    tiles_by_node: defaultdict[int, list[_Tile]] = defaultdict(list)
    for tile in tiles:
        tiles_by_node[tile.node].append(tile)
    images_by_uri = {tile.uri: image for tile, image in zip(tiles, images, strict=False)}
    # From the last node to the root: children are described before their parent.
    for node in range(snapped.nodes - 1, -1, -1):
        children = [entries[int(child)] for child in snapped.children[node]]
        for is_base in (True, False):
            here = [tile for tile in tiles_by_node[node] if tile.is_base is is_base]
            if not here:
                continue
            below, children = children, []
            for tile in here:
                lowest, highest = boxes[tile.uri] if is_base else (low[node], high[node])
                box = {"box": _make_box(lowest, highest, grid)}
                colors = {} if snapped.colors is None else {"color_bound_levels": tile.color_bound}
                if tile.uri in images_by_uri:
                    colors = images_by_uri[tile.uri].to_dict()
                children.append(_describe_tile(tile, box, below, colors, snapped.is_one_sided))
        (entries[node],) = children
    root = entries[0]
    transform = np.eye(4)
    transform[:3, :3] = rotate_to_z(up)
    transform[:3, 3] = transform[:3, :3] @ grid.origin
    moves = not np.array_equal(transform, np.eye(4))
    # The tileset's error applies if no tile is shown: then the whole model is missing.
    diagonal = float(np.linalg.norm(high[0] - low[0]))
    extras: Tree = {"scanloom": get_installed_version()}
    facing = estimate_mean_normal(snapped.mesh([0], [0]), rotate_to_z(up))
    if facing is not None:
        extras["facing"] = facing
    if snapped.is_one_sided:
        extras |= {
            "one_sided": True,
            "dropped_islands": snapped.dropped_islands,
            "dropped_triangles": snapped.dropped_triangles,
        }
    return {
        "asset": {"version": "1.1", "extras": extras},
        "geometricError": max(diagonal, root["geometricError"]),
        "root": {
            **({"transform": transform.T.reshape(-1).tolist()} if moves else {}),
            "refine": "REPLACE",
            **root,
        },
    }


def _describe_tile(tile: _Tile, volume: Tree, children: list[Tree], colors: Tree, is_one_sided: bool) -> Tree:
    """Build the tileset.json entry of a tile with its bounds and children."""
    extras: Tree = {"shape_bound_m": tile.shape_bound, **colors}
    if is_one_sided:
        extras["one_sided"] = True
    return {
        "boundingVolume": volume,
        "geometricError": max([tile.shape_bound, *(child["geometricError"] for child in children)]),
        "content": {"uri": tile.uri, "extras": extras},
        **({"children": children} if children else {}),
    }


def _make_box(low: Floats, high: Floats, grid: PositionGrid) -> list[float]:
    """Return a bounding box as centre and half axes.

    It is enlarged by a grid step on all sides. The margin gives flat boxes a thickness. Nested boxes stay
    nested, because these sums are exact on the grid.
    """
    half = 0.5 * (high - low) + grid.step
    return [*(0.5 * (low + high)).tolist(), *np.diag(half).reshape(-1).tolist()]
