"""Simplification that keeps colours: to a number of triangles, or within bounds on shape and colour."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stages import _kernels
from stages.centred import Light, as_result, attributes_of, centred, fitted
from stages.certified import simplify_certified
from stages.collapse_record import CollapseRecord
from stages.color_weight import color_weight
from stages.convert import MeshLike, as_mesh
from stages.errors import MeshError, UsageError
from stages.jia01_limits import limits_of
from stages.mesh import Mesh
from stages.params import check, param, resolve
from stages.progress import Progress, silent
from stages.regions import Region, resolve_control
from stages.spatial_order import is_scattered, ordered, with_rows

VERSION = 5

# Triangles worked on at a time. Sums that grow from collapse to collapse mind the rims more, and want larger
# patches.
_PATCH_TRIANGLES = {"quadric": 8192, "jia01": 16384}

# What splitting may lead to: about 4 GB.
_TRIANGLE_LIMIT = 20_000_000

# What only one of the methods has to tell.
_FIGURES = {
    "quadric": ("fitted",),
    "certified": (
        "shape_bound_m",
        "shape_attained_m",
        "color_bound_levels",
        "color_attained_levels",
        "proven",
        "unproven_triangles",
        "iterations",
        "max_shape_m",
        "max_texture_levels",
    ),
    "jia01": (
        "largest_shape_change_m",
        "largest_texture_change_levels",
        "resolution_m",
        "max_shape_m",
        "max_texture_levels",
        "bounded",
        "splits",
    ),
}


@dataclass(frozen=True, kw_only=True)
class SimplifyParams:
    """How, and how far, `simplify` goes.

    Any bound that is given is kept. For jia01 with `triangles` or `ratio`, one that is not given does not
    limit; its default then only helps to say which edges go first.
    """

    method: str = param(
        "auto",
        "quadric: to a number of triangles, with the least squared error of shape and colour. certified: as "
        "far as bounds on the distance and on the difference of colour are proven for every point. jia01: "
        "within bounds on the summed change of shape and texture. auto: quadric for triangles or ratio, "
        "certified for max_shape and max_texture, else, also with resolution or paper_rule, jia01.",
        choices=("auto", "quadric", "certified", "jia01"),
    )
    triangles: int | None = param(None, "Stop when at most this many triangles are left.", low=1)
    ratio: float | None = param(
        None, "Stop when at most this share of the input's triangles is left.", low=0, high=1, low_open=True
    )
    fit: bool = param(
        True,
        "quadric: move vertices and colours to fit the input by least squares at the end; boundaries stay.",
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour. Default: quadric derives it from the mesh and "
        "the number of triangles, certified from the mesh; jia01 takes max_shape / max_texture.",
        unit="m per level",
        low=0,
    )
    resolution: float | None = param(
        None,
        "jia01: wanted edge length: longer edges are split first, and do not collapse. Default: 36 times the "
        "mean edge length, more where splitting would add over 5 % of triangles.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_shape: float | None = param(
        None,
        "certified: largest distance of any point of either surface from the other; default: 0.5 % of the "
        "bounding box's diagonal. jia01: largest shape change, summed over the collapses around an edge; "
        "default: 0.1 of the resolution, but at most 0.5 % of the diagonal.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_texture: float | None = param(
        None,
        "certified: largest difference, Euclidean over the channels, between the colour at any point of "
        "either surface and that at any nearest point of the other; no bound if not given. jia01: the "
        "strongest contrast in the neighbourhood of a collapse, summed over the collapses around an edge, "
        "which far exceeds the colour error that results; default: 400.",
        unit="8-bit levels",
        low=0,
    )
    paper_rule: bool = param(
        False,
        "jia01: follow the paper: check the bounds after each collapse, so that the last one may overshoot, "
        "and measure shape at vertices only. Default: check before, and between vertices too; bounds then "
        "hold.",
    )
    threads: int | None = param(
        None,
        "Parts of the mesh worked on at the same time, with the same result; one a core if not given.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check(self)
        for name in ("resolution", "max_shape", "max_texture", "attribute_scale"):
            if getattr(self, name) == math.inf:
                raise UsageError(f"{name} is infinite; leave it out, and give triangles or ratio instead.")
        if self.triangles is not None and self.ratio is not None:
            raise UsageError("triangles and ratio are both given; give one of them.")

    @property
    def has_count(self) -> bool:
        """Whether a number of triangles is wanted."""
        return self.triangles is not None or self.ratio is not None

    def target(self, triangles: int) -> int:
        """Return how many of so many triangles are wanted; 0 if there is no such wish."""
        return math.floor(self.ratio * triangles) if self.ratio is not None else self.triangles or 0

    def chosen(self) -> str:
        """Return the method that `auto` stands for here, or the one that is given.

        Raises
        ------
        UsageError
            If the parameters do not suit the method.
        """
        bounds = [name for name in ("max_shape", "max_texture") if getattr(self, name) is not None]
        of_jia01 = ["resolution"] * (self.resolution is not None) + ["paper_rule"] * self.paper_rule
        if self.method == "jia01" or (self.method == "auto" and of_jia01):
            return "jia01"
        if self.method == "certified" or (self.method == "auto" and bounds):
            self._check_suits("certified", not_for=of_jia01)
            if not bounds:
                raise UsageError("method certified needs a bound; give max_shape, max_texture or both.")
            if self.has_count:
                count = "ratio" if self.triangles is None else "triangles"
                raise UsageError(
                    f"method certified goes as far as the bounds allow; leave out {count}, or choose jia01."
                )
            return "certified"
        if self.method == "quadric":
            self._check_suits("quadric", not_for=[*of_jia01, *bounds])
            if not self.has_count:
                raise UsageError("method quadric needs a number of triangles; give triangles or ratio.")
        return "quadric" if self.has_count else "jia01"

    def _check_suits(self, method: str, not_for: list[str]) -> None:
        if not_for:
            raise UsageError(f"{not_for[0]} has no meaning for method {method}; leave one of them out.")


@dataclass(frozen=True, eq=False)
class Simplified:
    """A simplified mesh, where its parts came from, and what limited it.

    Attributes
    ----------
    mesh : Mesh
    vertex_source : (p,) int32, for each vertex an input vertex that became part of it.
    triangle_source : (q,) int32, for each triangle the input triangle it is what is left of.
    method : "quadric", "certified" or "jia01".
    stopped_by : "bounds" when no edge may collapse any more, "triangles" when the wanted number was reached,
        "request" when the caller was content with less, "unproven" when the bounds cannot be proven.
    refused : edges of the result by the rule that refused them last: "length", "shape", "texture" and "color"
        are bounds; "topology" stands for a changed topology, "bridge" for an edge across the interior
        between two boundary vertices, "fold" for a flipped or degenerate triangle, "needle" for one too thin
        for a proof, "pinned" for an edge between two vertices that must stay. Edges whose turn had not come
        are not counted.
    attribute_scale_m_per_level : what was used.
    splits, collapses, attempts : edges split and collapsed; edges whose turn came, some repeatedly.
    triangles_before : triangles of the input.
    fitted : whether vertices and colours were moved to fit the input at the end.
    record : all collapses, if that was asked for.
    shape_bound, color_bound : certified: (q,) float64, metres and levels, proven for each triangle, both
        ways: for its points, and for points of the input whose nearest point is on it. `color_bound` is None
        for a mesh without colours. They may be as large as `max_shape` and `max_texture` though less would
        be true; `certify` comes closer.
    shape_bound_m, color_bound_levels : certified: the greatest of all, input and result.
    shape_attained_m, color_attained_levels : certified: the greatest found at a point; the true maximum is
        between that and the bound.
    proven : certified: whether max_shape and max_texture are proven. What is said of bounds holds anyway.
    unproven_triangles : certified: triangles of the result and of the input that are not proven to stay
        within max_shape and max_texture.
    iterations : certified: how often the mesh was simplified and what came out looked at.
    largest_shape_change_m, largest_texture_change_levels : jia01: largest sums on any edge at any time.
    resolution_m : jia01: what was used.
    max_shape_m, max_texture_levels : jia01 and certified: what was used; None for no bound.
    bounded : jia01: whether resolution, max_shape and max_texture were bounds, or only ordered the collapses.
    """

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    method: str
    stopped_by: str
    refused: dict[str, int]
    attribute_scale_m_per_level: float
    splits: int
    collapses: int
    attempts: int
    triangles_before: int
    fitted: bool = False
    record: CollapseRecord | None = None
    shape_bound: NDArray[np.float64] | None = None
    color_bound: NDArray[np.float64] | None = None
    shape_bound_m: float | None = None
    color_bound_levels: float | None = None
    shape_attained_m: float | None = None
    color_attained_levels: float | None = None
    proven: bool | None = None
    unproven_triangles: tuple[int, int] | None = None
    iterations: int | None = None
    largest_shape_change_m: float | None = None
    largest_texture_change_levels: float | None = None
    resolution_m: float | None = None
    max_shape_m: float | None = None
    max_texture_levels: float | None = None
    bounded: dict[str, bool] = field(default_factory=dict)

    def follow(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return an array (n, …) over the input's vertices for the result's: (p, …)."""
        return values[self.vertex_source]

    def figures(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON; what the method has no figure for is left out."""
        triangles = len(self.mesh.triangles)
        figures: dict[str, Any] = {
            "method": self.method,
            "triangles_before": self.triangles_before,
            "triangles": triangles,
            "vertices": len(self.mesh.vertices),
            "reduction": 1 - triangles / self.triangles_before if self.triangles_before else 0.0,
            "stopped_by": self.stopped_by,
            "refused_edges": dict(self.refused),
            "attribute_scale_m_per_level": self.attribute_scale_m_per_level,
            "collapses": self.collapses,
            "attempts": self.attempts,
        }
        return figures | {name: _plain(getattr(self, name)) for name in _FIGURES[self.method]}


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value


def simplify(
    mesh: MeshLike,
    params: SimplifyParams | None = None,
    *,
    lock: ArrayLike | None = None,
    importance: ArrayLike | None = None,
    regions: Sequence[Region] = (),
    record: bool = False,
    partial: bool = False,
    progress: Progress = silent,
    **changes: Any,
) -> Simplified:
    """Collapse edges until few enough triangles are left, or none may go within the bounds.

    Topology, boundary loops and orientation stay; a boundary shrinks only along itself; no triangle turns
    over. Equal input gives equal bytes, on any number of threads.

    Method `quadric`, for `triangles` or `ratio` alone: each collapse is the one that adds least to the
    squared distance from the input's triangles, in the space of position and colour, and puts the new vertex
    where that is least. At the end vertices move along their normals, and colours change, to fit the input.

    Method `certified`, for bounds: as `quadric`, as long as the vertices of the input stay within them. Then
    they are proven for every point between, and where that fails the work is done again more carefully.

    Method `jia01`, for bounds on sums: long edges are split; then edges collapse in the order of what was
    summed up around them. A new vertex is the mean of the projections of the edge's midpoint on the planes of
    the triangles around, in the space of position and colour.

    Parameters
    ----------
    mesh : Mesh, Open3D or trimesh triangle mesh, or (vertices, triangles), in metres; an oriented manifold.
        Vertices without triangles and triangles that name a vertex twice are left out.
    params : SimplifyParams; single fields can be given by name instead.
    lock : (n,) bool or vertex indices: these vertices stay to the bit, colour included. Others may collapse
        into them.
    importance : (n,) float above 0, factor of the squared error around each vertex; for `certified` at least
        1, and bounds there are divided by it. Not for `jia01`.
    regions : Sphere and Box of `stages.regions`, which lock the vertices they hold, or give them importance.
    record : keep all collapses, so that every mesh on the way can be had again. Only for `quadric`.
    partial : Ctrl-C gives out what there is by then, instead of raising KeyboardInterrupt; `certified` then
        still proves how far that is from the input, which takes a while.
    progress : called about ten times a second with the triangles that are gone and those that have to go;
        returning False gives out what there is by then, raising stops the work.

    Returns
    -------
    Simplified
        The mesh has colours if the input has. Normals are those of `vertex_source`; texture is not carried,
        and a note of the mesh says so; likewise when bounds are not proven.

    Raises
    ------
    MeshError
        For an edge with more than two triangles or inconsistent orientation, or a vertex where two fans
        touch; the message names them. `clean` repairs all three.
    UsageError
        For a parameter out of range or of another method, a bound on the colours of a mesh without, or a
        resolution so fine that splitting passes 20 million triangles.

    Notes
    -----
    With default bounds, and with a ratio of 0.1:

    ================================  =========  =======  =========  ============  ===========  =======
    mesh                              triangles  method   reduction  RMS distance  colour RMSE  PSNR
    ================================  =========  =======  =========  ============  ===========  =======
    room fused at 2 cm, 6.3 m across    144,611  jia01       67.9 %       1.1 mm   2.4 levels   40.4 dB
    room fused at 2 cm, 6.3 m across    144,611  quadric     90.0 %       1.1 mm   2.6 levels   39.8 dB
    unit sphere with a satellite map     73,728  jia01       77.5 %       0.4 mm   5.0 levels   34.2 dB
    unit sphere with a satellite map     73,728  quadric     90.0 %       0.2 mm   8.8 levels   29.2 dB
    ================================  =========  =======  =========  ============  ===========  =======

    The bounds that `certified` proves hold for positions as they are, and as 32-bit floats in a file: they
    contain 2⁻²² of the largest coordinate and 2⁻²⁰ of the bounding box's diagonal for that, and for searches
    in single precision. Twice as much is the least distance that can be proven, and takes the place of a
    smaller `max_shape`. Bounds need not be provable at all where sheets of different colours touch, since a
    point there has nearest points of both colours; triangles there stay as they are.

    For jia01, shape and texture changes are sums over collapses. The texture change counts contrast, not
    error, and so its default looks large.

    The paper looks at vertices only, and a long triangle can swing away between its corners; and it adds to
    each edge what happens around it, though a point may move on to another edge's triangle. Unless
    `paper_rule` is set, the shape change therefore also counts how far the surfaces are apart where old and
    new edges cross, or how far the ends move where the neighbourhood is folded; and every new edge starts
    from the largest sum around. The largest distance between input and result then stayed below `max_shape`
    wherever we measured it.

    References
    ----------
    quadric, certified: Garland and Heckbert, "Surface simplification using quadric error metrics", 1997;
    Hoppe, "New quadric metric for simplifying meshes with appearance attributes", 1999; for the fit Hoppe,
    DeRose, Duchamp, McDonald and Stuetzle, "Mesh optimization", 1993; and see `stages.certified`.

    jia01: Jia, Liu, Pei, Zhu and Li, "Mesh simplification with texture preservation", Journal of Image and
    Graphics 6(7), 2001: shape change (1)-(2), texture change (3), placement (4)-(6), order (7).
    """
    params = resolve(SimplifyParams, params, changes)
    method = params.chosen()
    mesh = as_mesh(mesh)
    locked, factors = resolve_control(mesh, lock, importance, regions)
    if record and method != "quadric":
        raise UsageError(f"method {method} keeps no record; give triangles or ratio, and no bound.")
    if len(factors) and method == "jia01":
        raise UsageError("importance has no meaning for method jia01; give triangles or ratio, and no bound.")
    if partial:
        progress = _contented(progress)
    if method == "certified":
        return _by_proof(mesh, params, locked, factors, partial, progress)
    running = _kernels.Running(
        patch_triangles=_PATCH_TRIANGLES[method],
        target_triangles=params.target(len(mesh.triangles)),
        threads=params.threads or 0,
        record=record,
        partial=partial,
    )
    try:
        if method == "quadric":
            # A record names the vertices of the input all along.
            run = _by_quadrics_in_order if not record and is_scattered(mesh) else _by_quadrics
            return run(mesh, params, locked, factors, running, progress)
        return _by_jia01(mesh, params, locked, running, progress)
    except _kernels.InvalidMeshError as error:
        raise MeshError(f"{error}; run clean first.", "mesh") from error


def _by_proof(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    importance: NDArray[np.float64],
    partial: bool,
    progress: Progress,
) -> Simplified:
    if params.max_texture is not None and mesh.colors is None:
        raise UsageError("max_texture is given, but the mesh has no vertex colours; leave it out.")
    found = simplify_certified(
        mesh,
        max_shape=params.max_shape,
        max_color=params.max_texture,
        fixed=lock,
        importance=importance,
        weight=params.attribute_scale,
        threads=params.threads or 0,
        partial=partial,
        progress=progress,
    )
    return Simplified(
        mesh=found.mesh,
        vertex_source=found.vertex_source,
        triangle_source=found.triangle_source,
        method="certified",
        stopped_by=found.stopped_by,
        refused=found.refused,
        attribute_scale_m_per_level=found.weight,
        splits=0,
        collapses=found.collapses,
        attempts=found.attempts,
        triangles_before=len(mesh.triangles),
        shape_bound=found.shape_bound,
        color_bound=found.color_bound,
        shape_bound_m=found.shape_bound_m,
        color_bound_levels=found.color_bound_levels,
        shape_attained_m=found.shape_attained_m,
        color_attained_levels=found.color_attained_levels,
        proven=found.proven,
        unproven_triangles=found.unproven[-1],
        iterations=found.iterations,
        max_shape_m=found.max_shape_m,
        max_texture_levels=params.max_texture,
    )


def _by_quadrics_in_order(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    importance: NDArray[np.float64],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    """Simplify a scattered mesh in an order that suits the caches; the result is in that of the input."""
    order = ordered(mesh)
    factors = importance[order.vertices] if len(importance) else importance
    try:
        found = _by_quadrics(order.mesh, params, lock[order.vertices], factors, running, progress)
    except _kernels.InvalidMeshError:
        # The message has to name what is wrong as the caller knows it.
        return _by_quadrics(mesh, params, lock, importance, running, progress)
    sources = order.vertices[found.vertex_source], order.triangles[found.triangle_source]
    vertices, triangles = (np.argsort(source) for source in sources)
    return replace(
        found,
        mesh=with_rows(found.mesh, vertices, triangles),
        vertex_source=sources[0][vertices].astype(np.int32),
        triangle_source=sources[1][triangles].astype(np.int32),
    )


def _by_quadrics(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    importance: NDArray[np.float64],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    given = centred(mesh)
    weight = params.attribute_scale
    if weight is None:
        weight = color_weight(mesh, running.target_triangles, running.threads)
    result = _kernels.simplify_by_quadrics(
        given.vertices,
        given.attributes,
        mesh.triangles,
        lock,
        importance,
        weight=weight,
        running=running,
        progress=progress,
    )
    source = result.vertex_source
    vertices, attributes = given.placed_back(result.vertices, source), result.attributes
    stopped_by, is_fitted = result.stopped_by, False
    if params.fit and result.collapses and stopped_by != "request":
        light = Light(vertices, attributes, result.triangles, source, result.became)
        try:
            vertices, attributes = fitted(
                light, given, lock, running.threads, _finishing(progress, len(mesh.triangles), running)
            )
            is_fitted = True
        except (_Content, KeyboardInterrupt) as stop:
            if not (running.partial or isinstance(stop, _Content)):
                raise
            stopped_by = "request"
    light_mesh = as_result(mesh, vertices, attributes, result.triangles, source, "simplify")
    kept = None
    if running.record:
        path = result.path.copy()
        path[:, :3] = given.placed_back(path[:, :3], result.survivor)
        base = mesh.with_(texture=None, notes=light_mesh.notes)
        kept = CollapseRecord(base, result.removed, result.survivor, path, lock)
    return Simplified(
        mesh=light_mesh,
        vertex_source=source,
        triangle_source=result.triangle_source,
        method="quadric",
        stopped_by=stopped_by,
        refused=result.standing,
        attribute_scale_m_per_level=weight,
        splits=0,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        fitted=is_fitted,
        record=kept,
    )


def _contented(progress: Progress) -> Progress:
    """Take Ctrl-C for a wish for what there is also while progress is being told."""

    def tell(done: int, total: int) -> object:
        try:
            return progress(done, total)
        except KeyboardInterrupt:
            return False

    return tell


class _Content(Exception):  # noqa: N818 (nothing went wrong)
    """The caller wants what there is."""


def _finishing(progress: Progress, triangles: int, running: _kernels.Running) -> Progress:
    """Keep telling that all triangles are gone that had to go, while the rest is being done."""
    going = max(triangles - running.target_triangles, 0)

    def tell(done: int, total: int) -> None:  # noqa: ARG001
        if progress(going, going) is False:
            raise _Content

    return tell


def _by_jia01(
    mesh: Mesh,
    params: SimplifyParams,
    lock: NDArray[np.bool_],
    running: _kernels.Running,
    progress: Progress,
) -> Simplified:
    limits = limits_of(
        mesh,
        params.resolution,
        params.max_shape,
        params.max_texture,
        params.attribute_scale,
        only_given=params.has_count,
        threads=running.threads,
    )
    try:
        result = _kernels.simplify(
            mesh.vertices,
            attributes_of(mesh),
            mesh.triangles,
            lock,
            bounds=limits.bounds,
            scales=limits.scales,
            attribute_scale=limits.attribute_scale,
            paper_rule=params.paper_rule,
            triangle_limit=max(_TRIANGLE_LIMIT, len(mesh.triangles)),
            running=running,
            progress=progress,
        )
    except _kernels.LimitError as error:
        raise UsageError(
            f"resolution is {limits.scales[0]:g} m, and with edges no longer than that {error}; "
            "give a coarser one."
        ) from error
    names = ("resolution", "max_shape", "max_texture")
    return Simplified(
        mesh=as_result(
            mesh, result.vertices, result.attributes, result.triangles, result.vertex_source, "simplify"
        ),
        vertex_source=result.vertex_source,
        triangle_source=result.triangle_source,
        method="jia01",
        stopped_by=result.stopped_by,
        refused=result.standing,
        attribute_scale_m_per_level=limits.attribute_scale,
        splits=result.splits,
        collapses=result.collapses,
        attempts=result.attempts,
        triangles_before=len(mesh.triangles),
        largest_shape_change_m=result.largest_shape_change,
        largest_texture_change_levels=result.largest_texture_change,
        resolution_m=limits.scales[0],
        max_shape_m=limits.scales[1],
        max_texture_levels=limits.max_texture,
        bounded=dict(zip(names, map(math.isfinite, limits.bounds), strict=True)),
    )
