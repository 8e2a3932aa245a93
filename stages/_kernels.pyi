"""Mesh kernels in Rust. Private: `scanloom.stages.simplification.simplify` is the way in."""

from collections.abc import Callable, Sequence
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import disjoint_base

__all__ = [
    "NEEDLE",
    "ByPatches",
    "ByQuadrics",
    "BySeams",
    "BySums",
    "Certified",
    "DrawnMesh",
    "Front",
    "InvalidMeshError",
    "LaidOut",
    "Levels",
    "LimitError",
    "NearestSurface",
    "NormalMesh",
    "Photo",
    "PlanarPatches",
    "Proven",
    "Running",
    "SeamKnobs",
    "SeamLog",
    "Simplified",
    "SnmError",
    "SurfacePoints",
    "TexturedSurface",
    "View",
    "Volume",
    "WeldedSheets",
    "agreeing",
    "assemble_front",
    "build_levels",
    "certify",
    "color_weight",
    "decode_indices",
    "decode_normal_mesh",
    "decode_rows",
    "draw_sources",
    "encode_rows",
    "encode_triangles",
    "first_inside",
    "fit",
    "give_back",
    "inside_all",
    "intersecting_triangles",
    "lay_out",
    "locate_texels",
    "match_descriptors",
    "match_pair",
    "not_before",
    "oriented_depth",
    "planar_patches",
    "remesh",
    "sample_points",
    "sample_texels",
    "side_lengths",
    "simplify",
    "simplify_by_quadrics",
    "simplify_certified",
    "simplify_planar",
    "simplify_seams",
    "spatial_order",
    "strip_order",
    "sweep_planes",
    "texels",
    "touched_blocks",
    "weighted_medians",
    "weld_sheets",
]

# Height over longest side below which only the longest side of a triangle counts in a proof.
NEEDLE: float

class InvalidMeshError(ValueError):
    """The mesh breaks a rule the kernels need; the message names the elements."""

class LimitError(OverflowError):
    """The result would be larger than the stated limit."""

class SnmError(ValueError):
    """The bytes are no `.snm` file, or so damaged that no level is whole; the message says where."""

@final
class Running:
    """How a simplifier runs."""

    def __new__(
        cls,
        *,
        target_triangles: int = 0,
        threads: int = 0,
        region_triangles: int = ...,
        record: bool = False,
        partial: bool = False,
    ) -> Running: ...
    @property
    def target_triangles(self) -> int: ...
    @property
    def threads(self) -> int: ...
    @property
    def region_triangles(self) -> int: ...
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
    """All collapses of `simplify_seams`; the properties are those of a `CollapseRecord` and its `Wedges`."""

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
    """A mesh simplified along its seams."""

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
    def refused(self) -> dict[str, int]: ...
    @property
    def collapses(self) -> int: ...
    @property
    def attempts(self) -> int: ...
    @property
    def seam_drift(self) -> float: ...
    @property
    def fitted(self) -> bool: ...
    @property
    def provable(self) -> float | None: ...
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
    locked: NDArray[np.bool_],
    *,
    knobs: SeamKnobs,
    fit: bool,
    within: tuple[float, float, NDArray[np.float64]] | None = None,
    running: Running,
    progress: Callable[[int, int], object],
) -> BySeams: ...

@final
class WeldedSheets:
    """What `weld_sheets` returns."""

    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def touches(self) -> NDArray[np.bool_]: ...

def weld_sheets(sets: NDArray[np.int32], triangles: NDArray[np.int32]) -> WeldedSheets: ...

# (n, k): levels of colour, or numbers.
_Attributes: TypeAlias = NDArray[np.uint8] | NDArray[np.float64]
# fx, fy, cx, cy, width and height; and the (4, 4) matrix that takes the world to the camera.
# The first block of a box along each axis, and the one after its last.
_Blocks: TypeAlias = tuple[Sequence[int], Sequence[int]]
_Camera: TypeAlias = tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]
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
    """A simplified mesh and how it came about."""

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
    def refused(self) -> dict[str, int]: ...
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
    """A mesh simplified with JIA01, and the sums that came up."""

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
    locked: NDArray[np.bool_],
    *,
    bounds: tuple[float, float, float],
    scales: tuple[float, float, float],
    attribute_scale: float,
    paper_rule: bool,
    triangle_limit: int,
    running: Running,
    progress: Callable[[int, int], object],
) -> BySums:
    """Simplify with JIA01; `bounds` and `scales` are (length, shape, texture), infinite for no bound."""

@final
class ByQuadrics(Simplified):
    """A mesh simplified by attribute quadrics."""

    @property
    def became(self) -> NDArray[np.int32]: ...

def simplify_by_quadrics(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    locked: NDArray[np.bool_],
    importance: NDArray[np.float64],
    *,
    weight: float,
    running: Running,
    progress: Callable[[int, int], object],
) -> ByQuadrics:
    """Simplify by attribute quadrics; `weight` is the length that counts as one level of an attribute."""

def fit(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    locked: NDArray[np.bool_],
    original_vertices: NDArray[np.float64],
    original_attributes: _Attributes,
    original_triangles: NDArray[np.int32],
    became: NDArray[np.int32],
    *,
    threads: int,
    progress: Callable[[int, int], object],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a simplified mesh to its input by least squares: vertices along their normals, and attributes."""

@final
class LaidOut:
    """A surface laid out: charts and images of triangles, −1 for none, and their corners in texels."""

    @property
    def charts(self) -> NDArray[np.int32]: ...
    @property
    def pages(self) -> NDArray[np.int32]: ...
    @property
    def corners(self) -> NDArray[np.float64]: ...
    @property
    def heights(self) -> list[int]: ...

def lay_out(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    density: NDArray[np.float32],
    *,
    side: int,
    padding: int,
    progress: Callable[[int, int], object],
) -> LaidOut:
    """Lay a surface out in images of `side` × `side`; `density` holds the texels a metre of each triangle."""

def give_back() -> None:
    """Give free memory that the allocator holds back to the system."""

def texels(
    corners: NDArray[np.float64], pages: NDArray[np.int32], *, page: int, width: int, height: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32]]:
    """Return the texels of one image, by triangles: pixels, triangles and shares of their corners."""

@final
class NearestSurface:
    """A surface that is asked for its nearest points."""

    def __new__(
        cls, vertices: NDArray[np.float64], triangles: NDArray[np.int32], *, wanted_threads: int
    ) -> NearestSurface: ...
    def closest(
        self, points: NDArray[np.float64], *, wanted_threads: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Return the nearest points to points (n, 3): triangles (n,), weights (n, 3) and distances (n,)."""

    def facing(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        *,
        reach: float,
        wanted_threads: int,
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.bool_]]:
        """Return the same for points of another surface with its unit normals (n, 3).

        A point that faces away is passed over for one that does not, along the normal and within reach.
        Instead of distances, where that was so.
        """

def draw_sources(
    simplified: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]],
    original: tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]],
    max_distances: NDArray[np.float64],
    *,
    width: int,
    height: int,
    wanted_threads: int,
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Draw the triangles of a simplified mesh, and its original's into their charts.

    A mesh is given by corners (m, 3, 2) in texels, charts (m,), and corners in space (m, 3, 3). Returns
    images (height, width) of both, which hold triangles, or −1 for none.
    """

def locate_texels(
    corners: NDArray[np.float64],
    triangles: NDArray[np.int32],
    texels: NDArray[np.int64],
    *,
    width: int,
    wanted_threads: int,
) -> NDArray[np.float32]:
    """Return weights (n, 3) of the point of a triangle that is nearest to the centre of a texel."""

def sample_texels(
    atlas: NDArray[np.uint8],
    triangles: NDArray[np.int32],
    corners: NDArray[np.float64],
    uvs: NDArray[np.float64],
    is_shown: NDArray[np.bool_],
    image: NDArray[np.uint8],
    *,
    wrap: tuple[str, str],
    wanted_threads: int,
) -> None:
    """Sample an image into the texels of an atlas whose triangles show it; the others stay."""

def sample_points(
    image: NDArray[np.uint8],
    uvs: NDArray[np.float64],
    *,
    channels: int,
    wrap: tuple[str, str],
    wanted_threads: int,
) -> NDArray[np.uint8]:
    """Sample the first channels of an image at texture coordinates (n, 2), v up."""

@final
class Volume:
    """A field of signed distances in blocks of 8³ voxels; lengths in metres."""

    def __new__(
        cls,
        voxel_size: float,
        truncation: float,
        *,
        color: bool,
        most_blocks: int,
        instructions: str | None = None,
    ) -> Volume: ...
    @staticmethod
    def instructions() -> list[str]:
        """List the sets of instructions that a field may use, the widest first; all give the same bits."""
    @property
    def blocks(self) -> int:
        """Blocks in use."""
    @property
    def bytes(self) -> int:
        """Memory of the voxels."""
    def integrate(
        self,
        keys: NDArray[np.uint64],
        camera: _Camera,
        depth: NDArray[np.float32],
        obliqueness: NDArray[np.float32],
        color: NDArray[np.uint8] | None,
        *,
        weighing: tuple[float, float, float],
        wanted_threads: int,
    ) -> None:
        """Add a frame to the blocks with some keys; raises LimitError where there would be too many."""
    def frame_counts(self, *, within: _Blocks | None) -> NDArray[np.uint64]:
        """Of how many voxels near the surface each number (256,) of frames is, in a box of blocks."""
    def surface(
        self, least: int, *, within: _Blocks | None, wanted_threads: int
    ) -> tuple[
        tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
        list[NDArray[np.uint64]],
    ]:
        """Vertices (n, 3) in voxels, triangles (m, 3), colours (n, 3) 0 to 255, mean frames (n,).

        With a box of blocks, of these alone; triangles name vertices of others from n upward. Then of these
        the blocks, and codes of edges; and of those that others may name blocks, codes and numbers.
        """
    def voxels(
        self,
    ) -> tuple[
        NDArray[np.int32],
        NDArray[np.float32],
        NDArray[np.uint16],
        NDArray[np.uint8],
        NDArray[np.float32] | None,
    ]:
        """Blocks (n, 3), distances (n, 512) in truncations, weights, frames, colours (n, 512, 3) or None."""

@final
class DrawnMesh:
    """A mesh that many cameras look at."""

    def __new__(cls, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> DrawnMesh: ...
    def zbuffer(self, camera: _Camera, *, near: float) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return depth and triangle at each pixel of a camera, infinite and −1 where nothing is seen."""

    def parts(self) -> NDArray[np.uint32]:
        """Return the part that each triangle (m,) is in; parts that follow each other are near each other."""

@final
class Photo:
    """The colours that a camera took; `warp` holds shifts of the photo at the corners of a grid."""

    def __new__(
        cls,
        camera: _Camera,
        photo: NDArray[np.uint8],
        blurred: NDArray[np.uint8],
        *,
        warp: NDArray[np.float32] | None,
    ) -> Photo: ...

@final
class View:
    """A photo with what its camera sees of a mesh, and what it measured."""

    def __new__(
        cls,
        photo: Photo,
        mesh_camera: _Camera,
        mesh_nearest: NDArray[np.float32],
        mesh_depth: NDArray[np.float32],
        mesh_triangles: NDArray[np.int32],
        *,
        reach: tuple[float, float],
        measured: tuple[_Camera, NDArray[np.float32], NDArray[np.float32]] | None,
        worth: float,
        flattest: float,
    ) -> View: ...

@final
class SurfacePoints:
    """Points of a surface, by their triangles, each with the few views that show it best."""

    def __new__(
        cls,
        vertices: NDArray[np.float64],
        normals: NDArray[np.float64],
        triangles: NDArray[np.int32],
        of: NDArray[np.uint32],
        shares: NDArray[np.float32],
        *,
        kept: int,
    ) -> SurfacePoints: ...
    def see(self, view: View, number: int, *, remember: bool, wanted_threads: int) -> NDArray[np.uint32]:
        """Look at all points from one more view, and return the triangles that it may show.

        `see_again` takes those that were to be remembered.
        """

    def see_again(self, photo: Photo, number: int, *, wanted_threads: int) -> None:
        """Take the colours of a view anew, at the points at which it is one of the best."""

    def samples(self) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.float32]]:
        """Return views (n, k), the best first, −1 for none; colours (n, k, 3) and scores (n, k)."""

    def density(self) -> NDArray[np.float32]:
        """Return pixels a metre in the nearest view (n,), 0 where none shows a point."""

    def flat(self) -> NDArray[np.bool_]:
        """Return which points (n,) are seen, but flatter than anybody would want it."""

    def blend(
        self, *, blurred: int, details: int, deviations: float, levels: float, wanted_threads: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
        """Return colours (n, 3), the best view (n,), −1 for none, and how many views count (n,)."""

    def level(
        self,
        colors: NDArray[np.float32],
        pixels: NDArray[np.uint32],
        *,
        width: int,
        reach: float,
        wanted_threads: int,
    ) -> None:
        """Level colours (n, 3), in place, where the photos that count change from one pixel to the next.

        `pixels` (n,) are row × width + column in an image; `reach` is how many pixels a border is felt.
        """

    def neighbours(
        self, labels: NDArray[np.int32], pixels: NDArray[np.uint32], *, width: int, every: int
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
        """Return points (k, 2) beside each other in every so many rows of an image, and colours (k, 2, 3).

        They are those that the photo which counts most (`labels`, (n,), −1 for none) at the first, or else at
        the second, shows of both; other neighbours are left out. `pixels` as in `level`.
        """

@final
class TexturedSurface:
    """A mesh laid out in images."""

    def __new__(
        cls,
        vertices: NDArray[np.float64],
        triangles: NDArray[np.int32],
        corners: NDArray[np.float64],
        pages: NDArray[np.int32],
        images: Sequence[NDArray[np.uint8]],
    ) -> TexturedSurface: ...
    def seen_by(self, camera: _Camera, *, near: float) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return what a camera sees, (h, w, 3), and whether each pixel shows a triangle with an image."""

def color_weight(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    *,
    target: int,
    tried: bool,
    wanted_threads: int,
) -> float:
    """Return the length that should count as much as a level in a result of `target` triangles."""

def match_descriptors(
    source: NDArray[np.uint8], target: NDArray[np.uint8], *, distinct: float
) -> NDArray[np.int64]:
    """Return (m, 2) indices of descriptors that are each other's likest, and distinctly so, by the source's.

    Parameters
    ----------
    source, target : (n, 128) each, compared by the roots of their shares (RootSIFT).
    distinct : the likest must be nearer than this share of the distance to the next.
    """

def match_pair(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    *,
    lowest: int,
    count: int,
    wanted_threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int16], NDArray[np.int16], NDArray[np.int16]]:
    """Match a rectified pair (h, w, 3) semi-globally at the disparities `lowest` to `lowest + count - 1`.

    Returns
    -------
    Disparity of the left image, px; of the right image, whole px, NaN where the left shows nothing of it;
    the sum of costs of the best, by how much the second best is more, and the cost of the best alone.
    """

def sweep_planes(
    grey: NDArray[np.uint8],
    partners: Sequence[tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]],
    first: NDArray[np.int32],
    count: NDArray[np.uint16],
    bound: tuple[NDArray[np.float32], float] | None = None,
    *,
    planes: int,
    wanted_threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.int16]]:
    """Find the plane, of `count` from `first` on, on which each pixel of a view lies.

    Parameters
    ----------
    partners : warped images (h', w'), what of them is shown (0 nothing, 1 the scene, 2 nothing of the thing),
        and (planes, 3) maps: on a plane (x, y) of the view is seen at (s·x + a, s·y + b), as s, a, b.
    first, count : (h, w); `count` is a multiple of 16.
    bound : (h, w) the nearest plane of each pixel, NaN where any may be, and what each plane farther costs.

    Returns
    -------
    The plane's number with a fraction, and by how much the next best sum of costs is more.
    """

def agreeing(
    depth: NDArray[np.float32],
    others: Sequence[tuple[NDArray[np.float64], NDArray[np.float32]]],
    *,
    tolerances: tuple[float, float],
    wanted_threads: int,
) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Count the other views whose depth maps say the same, within two shares of depth.

    Parameters
    ----------
    others : (3, 4) matrices from (u z, v z, z, 1) to (u' z', v' z', z'), and depth maps.
    """

def inside_all(
    depth: NDArray[np.float32],
    masks: Sequence[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    *,
    wanted_threads: int,
) -> NDArray[np.bool_]:
    """Return which places lie in the masks of all views that look at them; matrices as of `agreeing`."""

def not_before(
    depth: NDArray[np.float32],
    others: Sequence[tuple[NDArray[np.float64], NDArray[np.float32]]],
    *,
    share: float,
    wanted_threads: int,
) -> NDArray[np.uint8]:
    """Count the other views whose depth is more than a share of the place's; matrices as of `agreeing`."""

def first_inside(
    wanted: NDArray[np.bool_],
    masks: Sequence[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    *,
    least: int,
    span: tuple[float, float],
    steps: int,
    wanted_threads: int,
) -> NDArray[np.float32]:
    """Return the depth at which rays of wanted pixels first lie in the masks of all views that look there.

    Parameters
    ----------
    masks : matrices as of `agreeing`, and masks.
    least : as many views must look there.
    span : the nearest and the farthest depth that is tried, in so many `steps` of inverse depth.

    Returns
    -------
    (h, w), 0 where there is none.
    """

def oriented_depth(
    depth: NDArray[np.float32],
    pinhole: tuple[float, float, float, float, int, int],
    *,
    limits: tuple[float, float, float, float],
    wanted_threads: int,
) -> tuple[
    NDArray[np.float32],
    tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    NDArray[np.float32],
]:
    """Filter a depth map; also the normals of its surface, and their lengths."""

def touched_blocks(
    camera: _Camera,
    depth: NDArray[np.float32],
    normal: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]],
    obliqueness: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    *,
    voxel_size: float,
    truncation: float,
    within: _Blocks | None,
) -> NDArray[np.uint64]:
    """List the keys of the blocks that a frame touches, sorted."""

def weighted_medians(
    image: NDArray[np.uint8],
    disparity: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    *,
    lowest: int,
    count: int,
    radius: int,
    falloff: float,
    wanted_threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return medians of disparities (NaN where not known), weighted by likeness of colour.

    Returns
    -------
    The median at the pixels that are wanted, NaN elsewhere and where nothing around is known; the share of
    the known weight that is within a pixel of it; the share of all weight that is known.
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
    """Bound how far two triangle soups (vertices, attributes, triangles) are apart."""

@final
class Proven(Simplified):
    """A simplified mesh and what is proven of it; pairs are (shape in metres, colour in levels)."""

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
    locked: NDArray[np.bool_],
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
    """Simplify within bounds that are proven to hold everywhere; infinite for none."""

@final
class Levels:
    """A hierarchy of levels; nodes from the root down."""

    @property
    def parent(self) -> NDArray[np.int32]: ...
    @property
    def level(self) -> NDArray[np.int32]: ...
    @property
    def shape_bound(self) -> NDArray[np.float64]: ...
    @property
    def color_bound(self) -> NDArray[np.float64]: ...
    @property
    def shape_attained(self) -> NDArray[np.float64]: ...
    @property
    def color_attained(self) -> NDArray[np.float64]: ...
    @property
    def coarse(self) -> NDArray[np.int32]: ...
    @property
    def roots(self) -> int: ...
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def attributes(self) -> NDArray[np.float64]: ...
    @property
    def origin(self) -> NDArray[np.int32]: ...
    @property
    def made(self) -> NDArray[np.uint8]: ...
    @property
    def born(self) -> NDArray[np.uint8]: ...
    @property
    def first_split(self) -> NDArray[np.int64]: ...
    @property
    def first_triangle(self) -> NDArray[np.int64]: ...
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def stopped(self) -> bool: ...
    @property
    def unproven(self) -> int: ...

def build_levels(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    locked: NDArray[np.bool_],
    *,
    first: float,
    ratio: float,
    most: int,
    root: int,
    weight: float,
    share: float,
    tolerance: tuple[float, float],
    effort: float,
    single: bool,
    running: Running,
    progress: Callable[[int, int], object],
) -> Levels:
    """Build the levels of a manifold."""

@final
class Front:
    """The mesh of a front: its triangles, their places in the hierarchy, and the vertices they use."""

    @property
    def vertices(self) -> NDArray[np.int32]: ...
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def source(self) -> NDArray[np.int32]: ...

def assemble_front(
    triangles: NDArray[np.uint32],
    origin: NDArray[np.uint32],
    *,
    roots: int,
    start: NDArray[np.int64],
    count: NDArray[np.int64],
    below: NDArray[np.int64],
) -> Front:
    """Put together the mesh of some nodes.

    Of each the first `count` triangles from `start` on, with vertices below `below`.
    """

@disjoint_base
class PlanarPatches:
    """The near-planar patches of a mesh, largest area first."""

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
    """A mesh simplified by near-planar patches; its vertices are those of `vertex_source`."""

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
    locked: NDArray[np.bool_],
    *,
    cosines: tuple[float, float, float],
    bounds: tuple[float, float],
    threads: int,
    partial: bool,
    progress: Callable[[int, int], object],
) -> ByPatches:
    """Simplify by near-planar patches."""

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

def intersecting_triangles(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    wanted_threads: int,
    progress: Callable[[int, int], object],
) -> NDArray[np.uint32]:
    """Return for each triangle one that it meets beyond what both share; 2³² − 1 for none."""

def spatial_order(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Return vertices and triangles in an order in which neighbours in space are neighbours in memory."""

@final
class NormalMesh:
    """A base mesh and its refinements. Level 0 is the base; what leads to a level has the level's number."""

    @property
    def levels(self) -> int: ...
    @property
    def promised(self) -> int: ...
    @property
    def damage(self) -> str | None: ...
    @property
    def folded(self) -> list[int]:
        """Triangles of each level that are turned over or have no area; empty after decoding."""
    @property
    def tolerance(self) -> float | None:
        """Of the file, in diagonals; None after decoding."""
    @property
    def tolerance_source(self) -> str | None:
        """What says so: given, distance, noise, bound or precision; None after decoding."""
    @property
    def data(self) -> bytes: ...
    @property
    def level_ends(self) -> list[int]: ...
    @property
    def base_source(self) -> NDArray[np.int32] | None: ...
    @property
    def reached(self) -> list[float]: ...
    @property
    def up(self) -> list[float] | None:
        """What is up (3,), of length 1, where that is known."""
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
    original: tuple[NDArray[np.float64], NDArray[np.int32]] | None,
    *,
    levels: int | None,
    base_triangles: int,
    base_error: float,
    at_any_price: bool,
    max_error: float,
    butterfly: bool,
    relaxations: int,
    tolerance: float | None,
    color_tolerance: float,
    up: tuple[float, float, float] | None,
    threads: int,
    progress: Callable[[int, int], object],
) -> NormalMesh:
    """Make a normal mesh; `colors` and `confidence` may have no columns and no rows.

    `original` is the surface of which a simplified mesh without levels was made.
    """

def decode_normal_mesh(data: bytes, level: int) -> NormalMesh:
    """Decode an `.snm` file up to a level, or all of it with -1."""

def strip_order(triangles: NDArray[np.int32], vertices: int) -> NDArray[np.int32]:
    """Return triangles (m, 3) of so many vertices in an order that packs well."""

def encode_rows(rows: NDArray[np.uint8]) -> bytes:
    """Pack rows (n, k) of bytes, k a multiple of 4 up to 256, as EXT_meshopt_compression's ATTRIBUTES."""

def decode_rows(packed: bytes, count: int, size: int, filtered: str) -> bytes:
    """Return rows of `size` bytes of what is packed as ATTRIBUTES; ValueError if it is damaged."""

def decode_indices(packed: bytes, count: int, size: int, mode: str) -> bytes:
    """Return indices of 2 or 4 bytes of what is packed as TRIANGLES or INDICES; else ValueError."""

def encode_triangles(triangles: NDArray[np.int32], vertices: int) -> bytes:
    """Pack triangles (m, 3) as EXT_meshopt_compression's TRIANGLES."""
