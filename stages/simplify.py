"""Texture-preserving simplification: split long edges, collapse what may go, within stated bounds."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages import _kernels
from stages.convert import MeshLike, as_mesh
from stages.errors import MeshError, UsageError
from stages.mesh import Mesh
from stages.params import check, param, resolve
from stages.progress import Progress, silent

VERSION = 3

# The defaults, found on a room fused at 2 cm and on a globe with a satellite map (see `simplify`).
EDGES_PER_RESOLUTION = 36.0  # wanted edge length / mean edge length of the input
SHAPE_PER_RESOLUTION = 0.1  # the paper's choice
SHAPE_PER_DIAGONAL = 0.005  # a mesh of few large triangles must not lose its shape
MAX_TEXTURE = 400.0  # 8-bit levels, summed over the collapses around an edge

# By default, splitting may add this share of the triangles: a few long edges must not decide for all others.
_SPLIT_SHARE = 0.05
# What splitting may lead to: about 4 GB.
_TRIANGLE_LIMIT = 20_000_000

_BOUNDS = ("resolution", "max_shape", "max_texture")


@dataclass(frozen=True, kw_only=True)
class SimplifyParams:
    """How far `simplify` may go.

    With `triangles` or `ratio`, a bound that is not given does not limit; its default then only helps to say
    which edges go first. Any bound that is given is kept.
    """

    resolution: float | None = param(
        None,
        "Wanted edge length: longer edges are split first, and do not collapse. Default: 36 times the mean "
        "edge length, more where splitting would add over 5 % of triangles.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_shape: float | None = param(
        None,
        "Largest shape change, summed over the collapses around an edge. Default: 0.1 of the resolution, "
        "but at most 0.5 % of the bounding box's diagonal.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_texture: float | None = param(
        None,
        "Largest texture change: the strongest contrast in the neighbourhood of a collapse, summed over the "
        "collapses around an edge. It far exceeds the colour error that results. Default: 400.",
        unit="8-bit levels",
        low=0,
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour when a new vertex is placed. "
        "Default: max_shape / max_texture.",
        unit="m per level",
        low=0,
    )
    triangles: int | None = param(None, "Stop when at most this many triangles are left.", low=1)
    ratio: float | None = param(
        None, "Stop when at most this share of the input's triangles is left.", low=0, high=1, low_open=True
    )
    paper_rule: bool = param(
        False,
        "Follow the paper: check the bounds after each collapse, so that the last one may overshoot, and "
        "measure shape at vertices only. Default: check before, and between vertices too; bounds then hold.",
    )

    def __post_init__(self) -> None:
        check(self)
        for name in ("resolution", "max_shape", "max_texture", "attribute_scale"):
            if getattr(self, name) == math.inf:
                raise UsageError(f"{name} is infinite; leave it out, and give triangles or ratio instead.")
        if self.triangles is not None and self.ratio is not None:
            raise UsageError("triangles and ratio are both given; give one of them.")


@dataclass(frozen=True, eq=False)
class Simplified:
    """A simplified mesh, where its parts came from, and what limited it.

    Attributes
    ----------
    mesh : Mesh
    vertex_source : (p,) int32, for each vertex an input vertex that became part of it.
    triangle_source : (q,) int32, for each triangle the input triangle it is what is left of.
    stopped_by : "bounds" when no edge may collapse any more, "triangles" when the wanted number was reached.
    refused : edges of the result by the rule that refused them last: "length", "shape" and "texture" are the
        three bounds; "topology" stands for a changed topology, "bridge" for an edge across the interior
        between two boundary vertices, "fold" for a flipped or degenerate triangle. Edges whose turn had not
        come when the wanted number of triangles was reached are not counted.
    largest_shape_change_m, largest_texture_change_levels : largest sums on any edge at any time.
    resolution_m, max_shape_m, max_texture_levels, attribute_scale_m_per_level : what was used.
    bounded : whether resolution, max_shape and max_texture were bounds, not only the order of collapses.
    splits, collapses, attempts : edges split and collapsed; edges whose turn came, some repeatedly.
    triangles_before : triangles of the input.
    """

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    stopped_by: str
    refused: dict[str, int]
    largest_shape_change_m: float
    largest_texture_change_levels: float
    resolution_m: float
    max_shape_m: float
    max_texture_levels: float
    attribute_scale_m_per_level: float
    bounded: dict[str, bool]
    splits: int
    collapses: int
    attempts: int
    triangles_before: int

    def figures(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON."""
        triangles = len(self.mesh.triangles)
        return {
            "triangles_before": self.triangles_before,
            "triangles": triangles,
            "vertices": len(self.mesh.vertices),
            "reduction": 1 - triangles / self.triangles_before if self.triangles_before else 0.0,
            "stopped_by": self.stopped_by,
            "refused_edges": dict(self.refused),
            "largest_shape_change_m": self.largest_shape_change_m,
            "largest_texture_change_levels": self.largest_texture_change_levels,
            "resolution_m": self.resolution_m,
            "max_shape_m": self.max_shape_m,
            "max_texture_levels": self.max_texture_levels,
            "attribute_scale_m_per_level": self.attribute_scale_m_per_level,
            "bounded": dict(self.bounded),
            "splits": self.splits,
            "collapses": self.collapses,
            "attempts": self.attempts,
        }


def simplify(
    mesh: MeshLike, params: SimplifyParams | None = None, *, progress: Progress = silent, **changes: Any
) -> Simplified:
    """Split long edges, then collapse edges until none may go or few enough triangles are left.

    A new vertex, position and colour together, is the mean of the projections of the edge's midpoint on the
    planes of the triangles around, in the space of position and colour. Topology, boundary loops and
    orientation stay; a boundary shrinks only along itself. Equal input gives equal bytes.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres; an oriented manifold.
        Vertices without triangles and triangles that name a vertex twice are left out.
    params : SimplifyParams; single fields can be given by name instead.
    progress : called about ten times a second; raising from it stops the work.

    Returns
    -------
    Simplified
        The mesh has colours if the input has. Normals are those of `vertex_source`; texture is not carried,
        and a note of the mesh says so.

    Raises
    ------
    MeshError
        For an edge with more than two triangles or inconsistent orientation, or a vertex where two fans
        touch; the message names them. `clean` repairs all three.
    UsageError
        For a parameter out of range, or a resolution so fine that splitting passes 20 million triangles.

    Notes
    -----
    Shape and texture changes are sums over collapses. The texture change counts contrast, not error, and so
    its default looks large. With the defaults:

    ==================================  =========  =========  ============  ============  =======
    mesh                                triangles  reduction  RMS distance  colour RMSE   PSNR
    ==================================  =========  =========  ============  ============  =======
    room fused at 2 cm, 6.3 m across      144,611     68.4 %        1.1 mm    2.5 levels  40.2 dB
    unit sphere with a satellite map       73,728     76.9 %        0.3 mm    5.1 levels  34.0 dB
    ==================================  =========  =========  ============  ============  =======

    The paper looks at vertices only, and a long triangle can swing away between its corners; and it adds to
    each edge what happens around it, though a point may move on to another edge's triangle. Unless
    `paper_rule` is set, the shape change therefore also counts how far the surfaces are apart where old and
    new edges cross, or how far the ends move where the neighbourhood is folded; and every new edge starts
    from the largest sum around. The largest distance between input and result then stayed below `max_shape`
    wherever we measured it.

    References
    ----------
    Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and Graphics
    6(7), 2001: shape change (1)-(2), texture change (3), placement (4)-(6), order (7).
    """
    params = resolve(SimplifyParams, params, changes)
    mesh = as_mesh(mesh)
    limits = _limits(mesh, params)
    count = len(mesh.triangles)
    target = params.triangles or 0
    if params.ratio is not None:
        target = math.floor(params.ratio * count)
    attributes = np.zeros((len(mesh.vertices), 0)) if mesh.colors is None else mesh.colors.astype(np.float64)
    try:
        result = _kernels.simplify(
            mesh.vertices,
            attributes,
            mesh.triangles,
            np.zeros(0, bool),
            bounds=limits.bounds,
            scales=limits.scales,
            attribute_scale=limits.attribute_scale,
            paper_rule=params.paper_rule,
            triangle_limit=max(_TRIANGLE_LIMIT, count),
            running=_kernels.Running(target_triangles=target),
            progress=progress,
        )
    except _kernels.LimitError as error:
        raise UsageError(
            f"resolution is {limits.scales[0]:g} m, and with edges no longer than that {error}; "
            "give a coarser one."
        ) from error
    except _kernels.InvalidMeshError as error:
        raise MeshError(f"{error}; run clean first.", "mesh") from error
    return Simplified(
        mesh=_result_mesh(mesh, result),
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        stopped_by=result.stopped_by,
        refused=result.standing,
        largest_shape_change_m=result.largest_shape_change,
        largest_texture_change_levels=result.largest_texture_change,
        resolution_m=limits.scales[0],
        max_shape_m=limits.scales[1],
        max_texture_levels=limits.max_texture,
        attribute_scale_m_per_level=limits.attribute_scale,
        bounded=dict(
            zip(("resolution", "max_shape", "max_texture"), map(math.isfinite, limits.bounds), strict=True)
        ),
        splits=result.splits,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=count,
    )


def _result_mesh(mesh: Mesh, result: _kernels.Simplified) -> Mesh:
    colors = None
    if mesh.colors is not None:
        # A projection can leave the range of colours a little.
        colors = np.rint(result.attributes).clip(0, 255).astype(np.uint8)
    normals = None if mesh.normals is None else mesh.normals[result.vertex_source]
    notes = mesh.notes
    if mesh.texture is not None:
        notes += ("simplify left the texture out: it carries vertex colours only.",)
    return Mesh(result.vertices, result.triangles, colors=colors, normals=normals, notes=notes)


@dataclass(frozen=True)
class _Limits:
    """L, S_max, T_max: as bounds (infinite for none) and as what the order of collapses is relative to."""

    bounds: tuple[float, float, float]
    scales: tuple[float, float, float]
    max_texture: float
    attribute_scale: float


def _limits(mesh: Mesh, params: SimplifyParams) -> _Limits:
    resolution = _default_resolution(mesh) if params.resolution is None else params.resolution
    max_shape = _default_shape(mesh, resolution) if params.max_shape is None else params.max_shape
    max_texture = MAX_TEXTURE if params.max_texture is None else params.max_texture
    # No texture change at all is a fair wish; it then needs another unit in the order.
    texture_scale = max_texture or 1.0
    attribute_scale = params.attribute_scale
    if attribute_scale is None:
        attribute_scale = max_shape / texture_scale
    only_wanted = params.triangles is not None or params.ratio is not None
    values = (resolution, max_shape, max_texture)
    wanted = (params.resolution, params.max_shape, params.max_texture)
    bounds = (
        math.inf if only_wanted and given is None else value
        for value, given in zip(values, wanted, strict=True)
    )
    return _Limits(
        bounds=(next(bounds), next(bounds), next(bounds)),
        scales=(resolution, max_shape, texture_scale),
        max_texture=max_texture,
        attribute_scale=attribute_scale,
    )


def _default_shape(mesh: Mesh, resolution: float) -> float:
    diagonal = float(np.linalg.norm(np.ptp(mesh.vertices, axis=0))) if len(mesh.vertices) else 0.0
    share = SHAPE_PER_RESOLUTION * resolution
    return min(share, SHAPE_PER_DIAGONAL * diagonal) if diagonal > 0 else share


def _default_resolution(mesh: Mesh) -> float:
    """Twelve mean edge lengths, or more if that would split too many edges."""
    corners = mesh.vertices[mesh.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).ravel()
    resolution = EDGES_PER_RESOLUTION * float(lengths.mean()) if len(lengths) else 0.0
    if not resolution > 0:
        return 1.0  # no edge has a length; any will do
    while _split_triangles(lengths, resolution) > _SPLIT_SHARE * len(mesh.triangles):
        resolution *= 1.1
    return resolution


def _split_triangles(lengths: NDArray[np.float64], resolution: float) -> float:
    """Triangles that splitting adds at least: sides are halved until short enough, each cut adds one."""
    pieces = np.exp2(np.ceil(np.log2(lengths[lengths > resolution] / resolution)))
    return float((pieces - 1).sum())
