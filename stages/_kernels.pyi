"""Mesh kernels in Rust. Private: `stages.simplification.simplify` is the way in."""

from collections.abc import Callable
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import disjoint_base

__all__ = [
    "ByPatches",
    "ByQuadrics",
    "BySeams",
    "BySums",
    "Certified",
    "InvalidMeshError",
    "LimitError",
    "NormalMesh",
    "PlanarPatches",
    "Proven",
    "Running",
    "SeamKnobs",
    "SeamLog",
    "Simplified",
    "SnmError",
    "WeldedSheets",
    "certify",
    "color_weight",
    "decode_normal_mesh",
    "fit",
    "planar_patches",
    "remesh",
    "side_lengths",
    "simplify",
    "simplify_by_quadrics",
    "simplify_certified",
    "simplify_planar",
    "simplify_seams",
    "spatial_order",
    "weld_sheets",
]

class InvalidMeshError(ValueError):
    """The mesh breaks a rule the kernels need; the message names the elements."""

class LimitError(OverflowError):
    """The result would be larger than the stated limit."""

class SnmError(ValueError):
    """The bytes are no `.snm` file, or so damaged that no level is whole; the message says where."""

@final
class Running:
    """How a simplifier runs.

    Up to how many triangles, on how many threads (0: one for each core; the result is the same), in patches
    of how many triangles, whether to record the path of the collapses, and whether Ctrl-C gives out what
    there is.
    """

    def __new__(
        cls,
        *,
        target_triangles: int = 0,
        threads: int = 0,
        patch_triangles: int = ...,
        record: bool = False,
        partial: bool = False,
    ) -> Running: ...
    @property
    def target_triangles(self) -> int: ...
    @property
    def threads(self) -> int: ...
    @property
    def patch_triangles(self) -> int: ...
    @property
    def record(self) -> bool: ...
    @property
    def partial(self) -> bool: ...

@final
class SeamKnobs:
    """Penalties and weights of `simplify_seams`."""

    def __new__(
        cls,
        *,
        across_materials: float,
        across_parts: float,
        valence: float,
        wedges: float,
        shape: float,
        seam_drift: float,
    ) -> SeamKnobs: ...

@final
class SeamLog:
    """All collapses of `simplify_seams`; the properties are those of a `SeamRecord`."""

    @property
    def removed(self) -> NDArray[np.int32]: ...
    @property
    def survivor(self) -> NDArray[np.int32]: ...
    @property
    def places(self) -> NDArray[np.float64]: ...
    @property
    def wedge_removed(self) -> NDArray[np.int32]: ...
    @property
    def wedge_survivor(self) -> NDArray[np.int32]: ...
    @property
    def wedge_when(self) -> NDArray[np.int32]: ...
    @property
    def changed(self) -> NDArray[np.int32]: ...
    @property
    def changed_to(self) -> NDArray[np.float64]: ...
    @property
    def changed_source(self) -> NDArray[np.int32]: ...
    @property
    def changed_when(self) -> NDArray[np.int32]: ...
    @property
    def corner_wedge(self) -> NDArray[np.int32]: ...
    @property
    def corner_vertex(self) -> NDArray[np.int32]: ...

@final
class BySeams:
    """A mesh simplified along its seams.

    `corners` (3 q, k) are the attributes of its corners, `corner_source` (3 q,) the corner of the input that
    has the same to the bit, −1 for none. `standing` counts the edges each rule holds at the end. `seam_drift`
    is the largest distance in the image of a seam from what it was, as a length.
    """

    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def corners(self) -> NDArray[np.float64]: ...
    @property
    def corner_source(self) -> NDArray[np.int32]: ...
    @property
    def vertex_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def stopped_by(self) -> str: ...
    @property
    def standing(self) -> dict[str, int]: ...
    @property
    def collapses(self) -> int: ...
    @property
    def attempts(self) -> int: ...
    @property
    def seam_drift(self) -> float: ...
    @property
    def fitted(self) -> bool: ...
    @property
    def log(self) -> SeamLog | None: ...

def simplify_seams(
    vertices: NDArray[np.float64],
    sets: NDArray[np.int32],
    triangles: NDArray[np.int32],
    corners: NDArray[np.float64],
    textured: NDArray[np.bool_],
    materials: NDArray[np.int32],
    parts: NDArray[np.int32],
    importance: NDArray[np.float64],
    fixed: NDArray[np.bool_],
    *,
    knobs: SeamKnobs,
    fit: bool,
    running: Running,
    progress: Callable[[int, int], object],
) -> BySeams: ...

@final
class WeldedSheets:
    """What `weld_sheets` returns.

    `triangles` (k, 3) number the vertices of the sheets, `triangle_source` (k,) says which triangle of the
    input each was, those with two corners in one set being left out, and `is_tied` (p,) which vertices lie
    where sheets touch.
    """

    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def is_tied(self) -> NDArray[np.bool_]: ...

def weld_sheets(sets: NDArray[np.int32], triangles: NDArray[np.int32]) -> WeldedSheets: ...

# (n, k): levels of colour, or numbers.
_Attributes: TypeAlias = NDArray[np.uint8] | NDArray[np.float64]
_Soup: TypeAlias = tuple[NDArray[np.float64], _Attributes, NDArray[np.int32]]

@final
class Certified:
    """Upper bounds by triangle; pairs are (shape in metres, colour in levels)."""

    @property
    def shape_bound(self) -> NDArray[np.float64]: ...
    @property
    def color_bound(self) -> NDArray[np.float64]: ...
    @property
    def original_shape_bound(self) -> NDArray[np.float64]: ...
    @property
    def original_color_bound(self) -> NDArray[np.float64]: ...
    @property
    def bound(self) -> tuple[float, float]: ...
    @property
    def attained(self) -> tuple[float, float]: ...
    @property
    def slack(self) -> float: ...
    @property
    def color_slack(self) -> float: ...
    @property
    def pieces(self) -> int: ...

@disjoint_base
class Simplified:
    """A simplified mesh and how it came about. `standing` counts the edges each rule holds at the end.

    `removed`, `survivor` and `path` hold, for each collapse, the vertex that vanished, the one it became part
    of and where that went, if that was asked for.
    """

    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def attributes(self) -> NDArray[np.float64]: ...
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def vertex_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def stopped_by(self) -> str: ...
    @property
    def standing(self) -> dict[str, int]: ...
    @property
    def collapses(self) -> int: ...
    @property
    def attempts(self) -> int: ...
    @property
    def removed(self) -> NDArray[np.int32]: ...
    @property
    def survivor(self) -> NDArray[np.int32]: ...
    @property
    def path(self) -> NDArray[np.float64]: ...

@final
class BySums(Simplified):
    """A mesh simplified with JIA01, and the sums that came up.

    `split` is what the collapses began with, where they were recorded and that is not the input: vertices,
    attributes, triangles, and the vertex and triangle of the input that each comes from.
    """

    @property
    def split(
        self,
    ) -> (
        tuple[
            NDArray[np.float64],
            NDArray[np.float64],
            NDArray[np.int32],
            NDArray[np.int32],
            NDArray[np.int32],
        ]
        | None
    ): ...
    @property
    def splits(self) -> int: ...
    @property
    def largest_shape_change(self) -> float: ...
    @property
    def largest_texture_change(self) -> float: ...

def side_lengths(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32], *, wanted_threads: int
) -> NDArray[np.float64]:
    """Return the lengths (m, 3) of the sides: entry k is that from corner k − 1 to corner k."""

def simplify(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    fixed: NDArray[np.bool_],
    *,
    bounds: tuple[float, float, float],
    scales: tuple[float, float, float],
    attribute_scale: float,
    paper_rule: bool,
    triangle_limit: int,
    running: Running,
    progress: Callable[[int, int], object],
) -> BySums:
    """Simplify with JIA01; `bounds` and `scales` are (length, shape, texture), infinite for no bound.

    Raises InvalidMeshError for a mesh it cannot work on, LimitError when splitting would pass
    `triangle_limit`.
    """

@final
class ByQuadrics(Simplified):
    """A mesh simplified by attribute quadrics.

    `became` holds, for each vertex of the input, the one of the result it became part of, -1 for none.
    """

    @property
    def became(self) -> NDArray[np.int32]: ...

def simplify_by_quadrics(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    fixed: NDArray[np.bool_],
    importance: NDArray[np.float64],
    *,
    weight: float,
    running: Running,
    progress: Callable[[int, int], object],
) -> ByQuadrics:
    """Simplify by attribute quadrics; `weight` is the length that counts as one level of an attribute.

    `fixed` and `importance` have one value a vertex, or none at all. Raises InvalidMeshError for a mesh it
    cannot work on.
    """

def fit(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    fixed: NDArray[np.bool_],
    original_vertices: NDArray[np.float64],
    original_attributes: _Attributes,
    original_triangles: NDArray[np.int32],
    became: NDArray[np.int32],
    *,
    threads: int,
    progress: Callable[[int, int], object],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a simplified mesh to its input by least squares: vertices along their normals, and attributes.

    `became` holds, for each original vertex, the vertex of the result it became part of, -1 for none. Raises
    InvalidMeshError for a mesh it cannot work on.
    """

def color_weight(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    *,
    target: int,
    tried: bool,
    wanted_threads: int,
) -> float:
    """Return the length that should count as much as a level in a result of `target` triangles.

    It makes the errors of shape and attributes to expect alike. If it is to be `tried`, a sample of the mesh
    is simplified alike, and it is made so small that it adds at most a fifth to the error of shape. 0 without
    attributes. Raises InvalidMeshError for an index out of range or a value that is not finite.
    """

def certify(
    result: _Soup,
    original: _Soup,
    *,
    tolerance: tuple[float, float],
    absolute_tolerance: tuple[float, float],
    limit: tuple[float, float] | None,
    effort: float,
    slack: float | None,
    threads: int,
    progress: Callable[[int, int], object],
) -> Certified:
    """Bound how far two triangle soups (vertices, attributes, triangles) are apart.

    Raises InvalidMeshError for an index out of range or a value that is not finite.
    """

@final
class Proven(Simplified):
    """A simplified mesh and what is proven of it; pairs are (shape in metres, colour in levels).

    `unproven` counts the triangles of the result, and of the input, without a proof.
    """

    @property
    def shape_bound(self) -> NDArray[np.float64]: ...
    @property
    def color_bound(self) -> NDArray[np.float64]: ...
    @property
    def bound(self) -> tuple[float, float]: ...
    @property
    def attained(self) -> tuple[float, float]: ...
    @property
    def slack(self) -> float: ...
    @property
    def color_slack(self) -> float: ...
    @property
    def proven(self) -> bool: ...
    @property
    def iterations(self) -> int: ...
    @property
    def unproven(self) -> tuple[int, int]: ...

def simplify_certified(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    fixed: NDArray[np.bool_],
    importance: NDArray[np.float64],
    *,
    bounds: tuple[float, float],
    weight: float,
    share: float,
    tolerance: tuple[float, float],
    effort: float,
    close: bool,
    running: Running,
    progress: Callable[[int, int], object],
) -> Proven:
    """Simplify within bounds that are proven to hold everywhere; infinite for none.

    `share` is the part of the bounds that samples may use; `tolerance` and `effort` are those of `certify`,
    whose bounds for single triangles are close only if `close` says so.
    Raises InvalidMeshError for a mesh it cannot work on.
    """

@disjoint_base
class PlanarPatches:
    """The near-planar patches of a mesh, largest area first.

    `input_patch` holds the patch of each triangle, -1 for one that names a vertex twice; `looks` counts how
    often a neighbour was looked at while they grew.
    """

    @property
    def input_patch(self) -> NDArray[np.int32]: ...
    @property
    def normals(self) -> NDArray[np.float64]: ...
    @property
    def origins(self) -> NDArray[np.float64]: ...
    @property
    def areas(self) -> NDArray[np.float64]: ...
    @property
    def thickness(self) -> NDArray[np.float64]: ...
    @property
    def faces(self) -> NDArray[np.int32]: ...
    @property
    def looks(self) -> int: ...

@final
class ByPatches(PlanarPatches):
    """A mesh simplified by near-planar patches; its vertices are those of `vertex_source`.

    `kept` says of each patch whether it has its own triangles still, `bounds` how far the surfaces are apart
    there at most, in shape and in colour; `refused` counts the edges of the input between patches.
    """

    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def vertex_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_patch(self) -> NDArray[np.int32]: ...
    @property
    def kept(self) -> NDArray[np.bool_]: ...
    @property
    def bounds(self) -> NDArray[np.float64]: ...
    @property
    def refused(self) -> dict[str, int]: ...
    @property
    def rounds(self) -> int: ...
    @property
    def is_partial(self) -> bool: ...

def simplify_planar(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    labels: NDArray[np.int32],
    fixed: NDArray[np.bool_],
    *,
    cosines: tuple[float, float, float],
    bounds: tuple[float, float],
    threads: int,
    partial: bool,
    progress: Callable[[int, int], object],
) -> ByPatches:
    """Simplify by near-planar patches.

    Triangles of a patch have one of the `labels` (m,), (0,) for none. `cosines` are the least ones of
    fidelity, detail and noise (above 1 for none); `bounds` are (shape, colour), the latter infinite for none.
    Raises InvalidMeshError for a mesh it cannot work on.
    """

def planar_patches(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    labels: NDArray[np.int32],
    *,
    cosines: tuple[float, float, float],
    bounds: tuple[float, float],
    threads: int,
    progress: Callable[[int, int], object],
) -> PlanarPatches:
    """Return the patches alone. Raises InvalidMeshError for a mesh it cannot work on."""

def spatial_order(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return vertices and triangles in an order in which neighbours in space are neighbours in memory.

    Raises InvalidMeshError for an index out of range or a value that is not finite.
    """

@final
class NormalMesh:
    """A base mesh and its refinements. Level 0 is the base; what leads to a level has the level's number.

    `levels` counts the refinements that are here, `promised` those the file was made with, and `damage` says
    why there are fewer, if something is wrong. `level_ends` holds the bytes of `data` up to the end of each
    level. What only the encoder knows is None after decoding: `base_source`, for each base vertex the one of
    the input, and `hit_triangle`, for each vertex of a level the triangle of the input it lies on. `reached`
    holds the largest distance found between each level and the input, if that was asked for.
    """

    @property
    def levels(self) -> int: ...
    @property
    def promised(self) -> int: ...
    @property
    def damage(self) -> str | None: ...
    @property
    def folded(self) -> int: ...
    @property
    def data(self) -> bytes: ...
    @property
    def level_ends(self) -> list[int]: ...
    @property
    def base_source(self) -> NDArray[np.int32] | None: ...
    @property
    def reached(self) -> list[float]: ...
    def vertices(self, level: int) -> NDArray[np.float64]:
        """Return (n, 3), metres."""
    def triangles(self, level: int) -> NDArray[np.int32]:
        """Return (m, 3)."""
    def colors(self, level: int) -> NDArray[np.uint8] | None:
        """Return (n, 3), None without colours."""
    def confidence(self, level: int) -> NDArray[np.float64] | None:
        """Return (n,), None without confidence."""
    def hit_triangle(self, level: int) -> NDArray[np.int32] | None:
        """Return (n,), None after decoding."""
    def kinds(self, level: int) -> NDArray[np.uint8]:
        """Return (k,) for the new vertices of a level: 0 scalar, 1 vector, 2 vector on the boundary."""
    def offsets(self, level: int) -> NDArray[np.float64]:
        """Return (k, 3), metres along the normal and two directions across; scalars have 0 for the latter."""
    def predicted(self, level: int) -> NDArray[np.float64]:
        """Return (k, 3), metres, where the new vertices of a level would be without offsets."""
    def frames(self, level: int) -> NDArray[np.float64]:
        """Return (k, 3), the unit normals at the new vertices of a level."""

def remesh(
    vertices: NDArray[np.float64],
    colors: NDArray[np.uint8],
    confidence: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    levels: int | None,
    base_triangles: int,
    base_error: float,
    at_any_price: bool,
    max_error: float,
    butterfly: bool,
    relaxations: int,
    tolerance: float,
    color_tolerance: float,
    threads: int,
    progress: Callable[[int, int], object],
) -> NormalMesh:
    """Make a normal mesh; `colors` and `confidence` may have no columns and no rows.

    Without `levels` there are as many as suit the input. `base_triangles` is 0 and `base_error` infinite for
    no such limit, kept `at_any_price` or not; `max_error` is 0 not to stop early; `tolerance` is a share of
    the diagonal, `color_tolerance` in levels, 0 threads for all cores. Raises InvalidMeshError for a mesh it
    cannot work on.
    """

def decode_normal_mesh(data: bytes, level: int) -> NormalMesh:
    """Decode an `.snm` file up to a level, or all of it with -1.

    Raises SnmError if not even the base mesh is whole.
    """
