"""Mesh kernels in Rust. Private: use `scanloom.stages.simplification.simplify` and the other stages."""

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import disjoint_base

__all__ = [
    "NEEDLE",
    "AtlasLayout",
    "BoundaryAligner",
    "CertifiedResult",
    "CertifyResult",
    "FrontMesh",
    "InvalidMeshError",
    "Jia01Result",
    "LevelHierarchy",
    "LimitError",
    "MeshRenderer",
    "NearestSurface",
    "NormalMesh",
    "Photo",
    "PlanarPatches",
    "PlanarResult",
    "QuadricResult",
    "RunSettings",
    "SeamLog",
    "SeamResult",
    "SeamWeights",
    "SimplificationResult",
    "SnmError",
    "SurfacePoints",
    "SurfaceRefiner",
    "TexturedSurface",
    "View",
    "Volume",
    "WeldedSheets",
    "assemble_front",
    "build_levels",
    "certify",
    "choose_color_weight",
    "compute_side_lengths",
    "compute_spatial_order",
    "compute_weighted_medians",
    "count_supporting_views",
    "decode_indices",
    "decode_normal_mesh",
    "decode_rows",
    "draw_sources",
    "encode_rows",
    "encode_triangles",
    "filter_depth",
    "find_hull_entry",
    "find_intersecting_triangles",
    "find_irregular_elements",
    "find_planar_patches",
    "find_touched_blocks",
    "fit",
    "fuse_depth_maps",
    "is_inside_all_masks",
    "label_components",
    "lay_out_atlas",
    "locate_texels",
    "match_descriptors",
    "match_pair",
    "optimize_strip_order",
    "rasterize_texels",
    "refine_inverse_depth",
    "release_free_memory",
    "remesh",
    "sample_points",
    "sample_texels",
    "simplify",
    "simplify_by_quadrics",
    "simplify_certified",
    "simplify_planar",
    "simplify_seams",
    "smooth_boundaries",
    "sweep_planes",
    "weld_sheets",
]

# Ratio of height to longest side; in a proof, a thinner triangle counts as its longest side.
NEEDLE: float

class InvalidMeshError(ValueError):
    """The mesh violates a requirement of the kernels; the message lists the elements."""

class LimitError(OverflowError):
    """The result would exceed the given limit."""

class SnmError(ValueError):
    """The bytes are not an `.snm` file, or are damaged before the end of the base mesh."""

@final
class RunSettings:
    """Common settings of the simplifiers."""

    def __new__(
        cls,
        *,
        target_triangles: int = 0,
        threads: int = 0,
        region_triangles: int = ...,
        record: bool = False,
        partial: bool = False,
    ) -> RunSettings: ...
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
class SeamWeights:
    """Penalties and weights of `simplify_seams`."""

    def __new__(
        cls,
        *,
        material_border_penalty: float,
        part_border_penalty: float,
        valence_penalty: float,
        duplicate_penalty: float,
        shape_weight: float,
        seam_drift: float,
    ) -> SeamWeights: ...

@final
class SeamLog:
    """Log of all collapses of `simplify_seams`; properties as in `CollapseRecord` and its `Wedges`."""

    @property
    def removed(self) -> NDArray[np.int32]: ...
    @property
    def survivor(self) -> NDArray[np.int32]: ...
    @property
    def positions(self) -> NDArray[np.float64]: ...
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
class SeamResult:
    """Mesh simplified with its texture seams."""

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
    def is_fitted(self) -> bool: ...
    @property
    def provable_distance(self) -> float | None: ...
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
    knobs: SeamWeights,
    fit: bool,
    within: tuple[float, float, NDArray[np.float64]] | None = None,
    running: RunSettings,
    progress: Callable[[int, int], object],
) -> SeamResult: ...

@final
class WeldedSheets:
    """Manifold sheets of a surface, the result of `weld_sheets`."""

    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def touches(self) -> NDArray[np.bool_]: ...

def weld_sheets(sets: NDArray[np.int32], triangles: NDArray[np.int32]) -> WeldedSheets: ...

# (n, k): colour levels, or floating-point numbers.
_Attributes: TypeAlias = NDArray[np.uint8] | NDArray[np.float64]
# First block of a box along each axis, and the end (exclusive).
_Blocks: TypeAlias = tuple[Sequence[int], Sequence[int]]
# fx, fy, cx, cy, width and height; and a (4, 4) matrix: camera-to-world for fusion, else world-to-camera.
_Camera: TypeAlias = tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]
_Soup: TypeAlias = tuple[NDArray[np.float64], _Attributes, NDArray[np.int32]]

@final
class CertifyResult:
    """Upper bounds per triangle; pairs are (shape in metres, colour in levels)."""

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
class SimplificationResult:
    """Simplified mesh with statistics of the run."""

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
class Jia01Result(SimplificationResult):
    """Mesh simplified with JIA01, with the largest accumulated changes."""

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

def compute_side_lengths(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32], *, wanted_threads: int
) -> NDArray[np.float64]:
    """Compute the side lengths (m, 3): entry k is the side from corner k − 1 to corner k."""

def simplify(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    locked: NDArray[np.bool_],
    *,
    bounds: tuple[float, float, float],
    scales: tuple[float, float, float],
    soft_length: bool,
    attribute_scale: float,
    paper_rule: bool,
    triangle_limit: int,
    running: RunSettings,
    progress: Callable[[int, int], object],
) -> Jia01Result:
    """Simplify with JIA01; `bounds` and `scales` are (length, shape, texture). Infinity disables a bound."""

@final
class QuadricResult(SimplificationResult):
    """Mesh simplified by attribute quadrics."""

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
    running: RunSettings,
    progress: Callable[[int, int], object],
) -> QuadricResult:
    """Simplify by attribute quadrics; `weight` is the length in metres equivalent to one attribute level."""

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
class AtlasLayout:
    """Surface flattened into an atlas: chart and page of each triangle (−1 for none), corners in texels."""

    @property
    def charts(self) -> NDArray[np.int32]: ...
    @property
    def pages(self) -> NDArray[np.int32]: ...
    @property
    def corners(self) -> NDArray[np.float64]: ...
    @property
    def heights(self) -> list[int]: ...

def lay_out_atlas(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    density: NDArray[np.float32],
    *,
    side: int,
    padding: int,
    progress: Callable[[int, int], object],
) -> AtlasLayout:
    """Lay a surface out in images of `side` × `side` texels; `density` is texels per metre per triangle."""

def release_free_memory() -> None:
    """Return free memory of the allocator to the system."""

def rasterize_texels(
    corners: NDArray[np.float64], pages: NDArray[np.int32], *, page: int, width: int, height: int
) -> tuple[NDArray[np.uint32], NDArray[np.uint32], NDArray[np.float32]]:
    """Find the texels of one page, sorted by triangle: pixels, triangles and barycentric weights."""

@final
class NearestSurface:
    """Surface with a search tree for nearest-point queries."""

    def __new__(
        cls, vertices: NDArray[np.float64], triangles: NDArray[np.int32], *, wanted_threads: int
    ) -> NearestSurface: ...
    def find_nearest(
        self, points: NDArray[np.float64], *, wanted_threads: int
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float64]]:
        """Find the nearest points to points (n, 3): triangles (n,), weights (n, 3) and distances (n,)."""

    def find_nearest_facing(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        *,
        reach: float,
        wanted_threads: int,
    ) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.bool_]]:
        """Find the nearest points to points with unit normals (n, 3) of another surface.

        A nearest point whose triangle faces away is replaced by one along the normal, within `reach`, that
        does not. Returns triangles, weights, and flags of replaced points instead of distances.
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
    """Rasterise the triangles of a simplified mesh, and of its original, into their charts.

    Each mesh is (corners (m, 3, 2) in texels, charts (m,), corner positions (m, 3, 3)). Returns an image
    (height, width) of triangle indices for each mesh, −1 for none.
    """

def locate_texels(
    corners: NDArray[np.float64],
    triangles: NDArray[np.int32],
    texels: NDArray[np.int64],
    *,
    width: int,
    wanted_threads: int,
) -> NDArray[np.float32]:
    """Compute barycentric weights (n, 3) of the points of triangles nearest to texel centres."""

def sample_texels(
    atlas: NDArray[np.uint8],
    triangles: NDArray[np.int32],
    corners: NDArray[np.float64],
    uvs: NDArray[np.float64],
    uses_image: NDArray[np.bool_],
    image: NDArray[np.uint8],
    *,
    wrap: tuple[str, str],
    wanted_threads: int,
) -> None:
    """Write samples of an image into the atlas texels of triangles that use the image, in place."""

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
class SurfaceRefiner:
    """Mesh under refinement.

    Show all frames, then `filter`; again, then `correct`, once or more; then `flatten`.
    """

    def __new__(
        cls,
        vertices: NDArray[np.float64],
        triangles: NDArray[np.int32],
        *,
        strength: float,
        wanted_threads: int,
    ) -> SurfaceRefiner: ...
    def observe(self, camera: _Camera, depth: NDArray[np.float32], noise: tuple[float, float]) -> None:
        """Compare the surface with a filtered depth map.

        `noise` is (constant, quadratic): the standard deviation of depth z is constant + quadratic · z²,
        metres.
        """
    def filter(self) -> None:
        """Measure the deviation of each vertex, and filter the surface."""
    def correct(self) -> None:
        """Move the surface to the observations, smoothly."""
    def flatten(self) -> None:
        """Make planar patches planar and their creases straight."""
    def finish(
        self,
    ) -> tuple[
        tuple[
            NDArray[np.float64],
            NDArray[np.int32],
            NDArray[np.uint32],
            NDArray[np.uint32],
            NDArray[np.float64],
        ],
        tuple[
            NDArray[np.float64],
            NDArray[np.float64],
            NDArray[np.float64],
            NDArray[np.bool_],
            NDArray[np.int32],
            int,
        ],
    ]:
        """Return the mesh and the values of its vertices.

        The mesh: vertices (n, 3), triangles (m, 3), input vertex of the first n − k vertices, and the ends
        (k, 2) and shares (k,) of the others, which were split off edges. The values (n,): moves and
        deviations in metres, largest cosine of the angle between normal and line of sight, 0 if no frame
        measured the vertex, True if more frames have seen free space there than surface, and its plane, −1
        for none; then the number of planes.
        """

@final
class BoundaryAligner:
    """Mesh whose boundaries move to the outlines in depth maps. Show all frames, then `finish`."""

    def __new__(
        cls, vertices: NDArray[np.float64], triangles: NDArray[np.int32], *, wanted_threads: int
    ) -> BoundaryAligner: ...
    def observe(self, camera: _Camera, depth: NDArray[np.float32], noise: tuple[float, float]) -> None:
        """Compare the boundaries with a filtered depth map. `noise` is as in `SurfaceRefiner.observe`."""
    def finish(self) -> NDArray[np.float64]:
        """Return the vertices (n, 3), moved at most one mean edge length within the surface."""

def smooth_boundaries(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    max_move_ratio: float,
    wanted_threads: int,
) -> NDArray[np.float64]:
    """Smooth the boundaries of a mesh, within its surface.

    Returns the vertices, moved at most `max_move_ratio` mean edge lengths.
    """

@final
class Volume:
    """TSDF volume in blocks of 8³ voxels; lengths in metres."""

    def __new__(
        cls,
        voxel_size: float,
        truncation: float,
        *,
        color: bool,
        max_blocks: int,
        instructions: str | None = None,
    ) -> Volume: ...
    @staticmethod
    def supported_instructions() -> list[str]:
        """List the supported instruction sets, widest first; all give identical bits."""
    @property
    def block_count(self) -> int:
        """Number of blocks in use."""
    @property
    def bytes(self) -> int:
        """Memory of the voxels in bytes."""
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
        """Integrate a frame into the blocks with the given keys; LimitError above `max_blocks` blocks."""
    def observation_histogram(self, *, within: _Blocks | None) -> NDArray[np.uint64]:
        """Compute the histogram (256,) of observation counts near the surface, in a box of blocks."""
    def extract_surface(
        self, min_frames: int, *, within: _Blocks | None, wanted_threads: int
    ) -> tuple[
        tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float32], NDArray[np.float32]],
        list[NDArray[np.uint64]],
    ]:
        """Extract the surface through voxels observed by at least `min_frames` frames.

        Returns vertices (n, 3) in voxels, triangles (m, 3), colours (n, 3) of 0 to 255 and mean observation
        counts (n,). `within` restricts the surface to a box of blocks; triangle indices from n on then refer
        to foreign vertices. The list is for stitching: block keys and edge codes of foreign vertices; block
        keys, edge codes and indices of shared vertices.
        """
    def copy_voxels(
        self,
    ) -> tuple[
        NDArray[np.int32],
        NDArray[np.float32],
        NDArray[np.uint16],
        NDArray[np.uint8],
        NDArray[np.float32] | None,
    ]:
        """Copy blocks (n, 3), distances (n, 512) in truncations, weights, observation counts and colours."""

@final
class MeshRenderer:
    """Mesh for rendering from many cameras."""

    def __new__(cls, vertices: NDArray[np.float64], triangles: NDArray[np.int32]) -> MeshRenderer: ...
    def render_zbuffer(
        self, camera: _Camera, *, near: float
    ) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Render depth and triangle at each pixel; infinity and −1 where nothing is visible."""

    def triangle_clusters(self) -> NDArray[np.uint32]:
        """Return the spatial cluster of each triangle (m,); consecutive clusters are close in space."""

@final
class Photo:
    """Photo of a camera; `warp` is its displacement in pixels at the nodes of a grid."""

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
    """Photo with the rendered mesh and the measured depth of its view."""

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
        weight: float,
        min_cosine: float,
    ) -> View: ...

@final
class SurfacePoints:
    """Points of a surface, grouped by triangle, each with the few views that show it best."""

    def __new__(
        cls,
        vertices: NDArray[np.float64],
        normals: NDArray[np.float64],
        triangles: NDArray[np.int32],
        point_triangles: NDArray[np.uint32],
        weights: NDArray[np.float32],
        *,
        samples_per_point: int,
    ) -> SurfacePoints: ...
    def add_view(self, view: View, number: int, *, remember: bool, wanted_threads: int) -> NDArray[np.uint32]:
        """Add the samples of one more view, and return the triangles that it may show.

        With `remember`, `update_view_colors` can update the view later.
        """

    def update_view_colors(self, photo: Photo, number: int, *, wanted_threads: int) -> None:
        """Update the colours of a view's samples at the points for which it is one of the best."""

    def samples(self) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.float32]]:
        """Return views (n, k), best first, −1 for none; colours (n, k, 3) and scores (n, k)."""

    def density(self) -> NDArray[np.float32]:
        """Return the maximum resolution of all views in pixels per metre (n,); 0 without a view."""

    def grazing_mask(self) -> NDArray[np.bool_]:
        """Return the mask (n,) of points that are only seen at grazing angles."""

    def blend(
        self, *, blurred: int, details: int, deviations: float, levels: float, wanted_threads: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
        """Blend colours (n, 3); also returns the best view (n,), −1 for none, and the inlier count (n,)."""

    def level_seams(
        self,
        colors: NDArray[np.float32],
        pixels: NDArray[np.uint32],
        *,
        width: int,
        reach: float,
        wanted_threads: int,
    ) -> None:
        """Level colours (n, 3) in place, where the set of contributing photos changes between texels.

        `pixels` (n,) are row × width + column in an image; `reach` is the decay length of corrections in
        pixels.
        """

    def collect_neighbours(
        self, labels: NDArray[np.int32], pixels: NDArray[np.uint32], *, width: int, row_step: int
    ) -> tuple[NDArray[np.uint32], NDArray[np.uint8]]:
        """Collect adjacent points (k, 2) in every `row_step`-th row of an image, and their colours (k, 2, 3).

        The colours are from the photo with the highest weight (`labels`, (n,), −1 for none) at the first
        point, or else at the second. Pairs that this photo does not show are skipped. `pixels` as in
        `level_seams`.
        """

@final
class TexturedSurface:
    """Mesh with texture images, for rendering."""

    def __new__(
        cls,
        vertices: NDArray[np.float64],
        triangles: NDArray[np.int32],
        corners: NDArray[np.float64],
        pages: NDArray[np.int32],
        images: Sequence[NDArray[np.uint8]],
    ) -> TexturedSurface: ...
    def render(self, camera: _Camera, *, near: float) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Render the surface from a camera: colours (h, w, 3), and the mask of textured pixels."""

def choose_color_weight(
    vertices: NDArray[np.float64],
    attributes: _Attributes,
    triangles: NDArray[np.int32],
    *,
    target: int,
    run_trial: bool,
    wanted_threads: int,
) -> float:
    """Compute the length in metres equivalent to one attribute level in a result of `target` triangles."""

def match_descriptors(
    source: NDArray[np.uint8], target: NDArray[np.uint8], *, max_distance_ratio: float
) -> NDArray[np.int64]:
    """Match descriptors that are mutual nearest neighbours; returns index pairs (m, 2), sorted by source.

    Parameters
    ----------
    source, target : (n, 128) SIFT descriptors, compared as RootSIFT.
    max_distance_ratio : ratio test; the nearest must be closer than this times the distance of the second
        nearest.
    """

def match_pair(
    left: NDArray[np.uint8],
    right: NDArray[np.uint8],
    *,
    lowest: int,
    count: int,
    wanted_threads: int,
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int16], NDArray[np.int16], NDArray[np.int16]]:
    """Match a rectified pair (h, w, 3) by semi-global matching.

    Disparities from `lowest` to `lowest + count - 1` are searched.

    Returns
    -------
    Disparity of the left image in px; disparity of the right image in whole px, NaN where no left pixel maps
    to it; path sum of the best disparity, its margin to the second best, and its matching cost.
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
    """Find the best depth plane of each pixel of a view by a plane sweep.

    Parameters
    ----------
    partners : per partner view the warped image (h', w'), its mask (0 outside the image, 1 scene, 2 outside
        the object's silhouette), and maps (planes, 3): (s, a, b) maps pixel (x, y) of the view to
        (s·x + a, s·y + b).
    first, count : (h, w) range of planes per pixel; `count` is a multiple of 16.
    bound : (h, w) nearest possible plane of each pixel, NaN for no limit, and the cost per plane behind it.

    Returns
    -------
    Plane index with a fraction, and margin to the second-best sum of costs.
    """

def refine_inverse_depth(
    grey: NDArray[np.uint8],
    partners: Sequence[tuple[NDArray[np.float64], NDArray[np.uint8]]],
    inverse: NDArray[np.float32],
    *,
    step: float,
    wanted_threads: int,
) -> NDArray[np.float32]:
    """Refine swept inverse depth to fractions of a plane.

    Parameters
    ----------
    partners : matrices as in `count_supporting_views`, and grey images.
    inverse : (h, w) 1/m.
    step : distance between planes, 1/m.
    """

def count_supporting_views(
    depth: NDArray[np.float32],
    other_views: Sequence[tuple[NDArray[np.float64], NDArray[np.float32]]],
    *,
    tolerances: tuple[float, float],
    min_depth_ratio: float,
    wanted_threads: int,
) -> list[NDArray[np.uint8]]:
    """Count the other views that support a depth.

    Parameters
    ----------
    other_views : (3, 4) projections from (u z, v z, z, 1) to (u' z', v' z', z'), and depth maps.
    tolerances : maximum relative differences of a consistent and of a nearly consistent depth.
    min_depth_ratio : a view is unoccluded if its depth is more than this ratio of the point's depth.

    Returns
    -------
    Numbers of consistent, nearly consistent and unoccluded views, and of views with any depth.
    """

def is_inside_all_masks(
    depth: NDArray[np.float32],
    masks: Sequence[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    *,
    wanted_threads: int,
) -> NDArray[np.bool_]:
    """Check whether points are inside the masks of all views that see them.

    Matrices as in `count_supporting_views`.
    """

def fuse_depth_maps(
    depth: NDArray[np.float32],
    confidence: NDArray[np.uint8],
    others: Sequence[tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float32], NDArray[np.uint8]]],
    *,
    tolerances: tuple[float, float],
    wanted_threads: int,
) -> tuple[NDArray[np.float32], list[NDArray[np.uint16]], list[NDArray[np.uint8]]]:
    """Fuse a depth map with the maps of other views, by the confidence that agrees with each depth.

    Parameters
    ----------
    depth : 0 where missing.
    others : projections into the other view and back, as in `count_supporting_views`, depth, and confidence.
    tolerances : relative, for averaging and for agreement.

    Returns
    -------
    Depth; sums of the confidences of other views that confirm the depth, and of those that see past it;
    number of confirming views within the wide and the narrow tolerance.
    """

def find_hull_entry(
    wanted: NDArray[np.bool_],
    masks: Sequence[tuple[NDArray[np.float64], NDArray[np.bool_]]],
    *,
    min_views: int,
    depth_range: tuple[float, float],
    steps: int,
    wanted_threads: int,
) -> NDArray[np.float32]:
    """Find the depth at which the rays of wanted pixels enter the visual hull.

    Parameters
    ----------
    masks : matrices as in `count_supporting_views`, and silhouette masks.
    min_views : minimum number of views that must see the point.
    depth_range : minimum and maximum depth, sampled in `steps` steps of inverse depth.

    Returns
    -------
    Depth (h, w), 0 where a ray misses the hull.
    """

def filter_depth(
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
    """Filter a depth map; also returns its scaled surface normals (one image per axis) and their lengths.

    `limits` are (minimum depth, maximum depth, relative jump, minimum cosine).
    """

def find_touched_blocks(
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
    """Find the sorted keys of the blocks that a frame touches."""

def compute_weighted_medians(
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
    """Compute medians of disparities (NaN where unknown), weighted by colour similarity.

    Returns
    -------
    Median at the wanted pixels, NaN elsewhere and where no disparity in the window is known; weight ratio of
    the known pixels within one disparity of the median; weight ratio of the known pixels.
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
) -> CertifyResult:
    """Bound the distance between two triangle soups (vertices, attributes, triangles)."""

@final
class CertifiedResult(SimplificationResult):
    """Simplified mesh with proven bounds; pairs are (shape in metres, colour in levels)."""

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
    running: RunSettings,
    progress: Callable[[int, int], object],
) -> CertifiedResult:
    """Simplify within bounds that are proven everywhere; infinity disables a bound."""

@final
class LevelHierarchy:
    """Hierarchy of levels, nodes from the root down."""

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
    def coarse_triangle_counts(self) -> NDArray[np.int32]: ...
    @property
    def root_vertex_count(self) -> int: ...
    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def attributes(self) -> NDArray[np.float64]: ...
    @property
    def origin(self) -> NDArray[np.int32]: ...
    @property
    def new_vertex_counts(self) -> NDArray[np.uint8]: ...
    @property
    def new_triangle_counts(self) -> NDArray[np.uint8]: ...
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
    max_cell_triangles: int,
    root_triangles: int,
    weight: float,
    share: float,
    tolerance: tuple[float, float],
    effort: float,
    single: bool,
    running: RunSettings,
    progress: Callable[[int, int], object],
) -> LevelHierarchy:
    """Build the levels of a manifold mesh."""

@final
class FrontMesh:
    """Mesh of a front: its triangles, their indices in the hierarchy, and the vertices they use."""

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
) -> FrontMesh:
    """Assemble the mesh of a front.

    Each node contributes the first `count` triangles from `start` on, with vertices below `below`.
    """

@disjoint_base
class PlanarPatches:
    """Near-planar patches of a mesh, largest area first."""

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
    def neighbour_tests(self) -> int: ...

@final
class PlanarResult(PlanarPatches):
    """Mesh simplified by near-planar patches; its vertices are the input vertices in `vertex_source`."""

    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def vertex_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_patch(self) -> NDArray[np.int32]: ...
    @property
    def kept_all_triangles(self) -> NDArray[np.bool_]: ...
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
) -> PlanarResult:
    """Simplify by near-planar patches."""

def find_planar_patches(
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
    """Compute the patches without simplifying. Raises InvalidMeshError for a non-manifold mesh."""

def find_intersecting_triangles(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    wanted_threads: int,
    progress: Callable[[int, int], object],
) -> NDArray[np.uint32]:
    """Find for each triangle one that it intersects beyond their shared vertices; 2³² − 1 for none."""

def find_irregular_elements(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    corner_deg: float,
    fold_deg: float,
    spike_deg: float,
    wanted_threads: int,
) -> tuple[dict[str, NDArray[np.int64]], dict[str, int]]:
    """Find the irregular elements of each class: vertices, edges (k, 2) or triangles, ascending.

    Also returns topological counts: edges, boundary_loops, components, used, referenced, repeating.
    """

def label_components(
    count: int, a: NDArray[np.integer[Any]], b: NDArray[np.integer[Any]]
) -> tuple[int, NDArray[np.int32]]:
    """Label the connected components of nodes joined by the pairs (a, b), int32 or int64.

    Returns their number, and the label (count,) of each node, numbered by the first nodes.
    """

def compute_spatial_order(
    vertices: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.uint32], NDArray[np.uint32]]:
    """Compute a Z-order of vertices and triangles, so that neighbours in space are close in memory."""

@final
class NormalMesh:
    """Base mesh with its levels. Level 0 is the base; a refinement step has the index of its result."""

    @property
    def levels(self) -> int: ...
    @property
    def encoded_levels(self) -> int: ...
    @property
    def damage(self) -> str | None: ...
    @property
    def folded_counts(self) -> list[int]:
        """Number of flipped or degenerate triangles of each level; empty after decoding."""
    @property
    def tolerance(self) -> float | None:
        """Tolerance of the file relative to the bounding-box diagonal; None after decoding."""
    @property
    def tolerance_source(self) -> str | None:
        """Origin of the tolerance: given, distance, noise, bound or precision; None after decoding."""
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
        """Up direction (3,) of length 1, None if unknown."""
    def vertices(self, level: int) -> NDArray[np.float64]:
        """Return the positions (n, 3) in metres."""
    def triangles(self, level: int) -> NDArray[np.int32]:
        """Return the triangles (m, 3)."""
    def colors(self, level: int) -> NDArray[np.uint8] | None:
        """Return the colours (n, 3); None without colours."""
    def confidence(self, level: int) -> NDArray[np.float64] | None:
        """Return the confidence (n,); None without confidence."""
    def hit_triangle(self, level: int) -> NDArray[np.int32] | None:
        """Return the input triangle (n,) of each vertex; None after decoding."""
    def kinds(self, level: int) -> NDArray[np.uint8]:
        """Return the offset kind (k,) of a level's new vertices: 0 scalar, 1 vector, 2 boundary vector."""
    def offsets(self, level: int) -> NDArray[np.float64]:
        """Return the offsets (k, 3) in metres along the normal and two tangents; scalars have tangents 0."""
    def predicted(self, level: int) -> NDArray[np.float64]:
        """Return the predicted positions (k, 3) in metres of a level's new vertices, without offsets."""
    def frames(self, level: int) -> NDArray[np.float64]:
        """Return the unit normals (k, 3) at the new vertices of a level."""

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
    ignore_cost_limit: bool,
    max_error: float,
    butterfly: bool,
    relaxations: int,
    tolerance: float | None,
    color_tolerance: float,
    up: tuple[float, float, float] | None,
    threads: int,
    progress: Callable[[int, int], object],
) -> NormalMesh:
    """Build a normal mesh; `colors` and `confidence` may be empty.

    `original` is the surface from which a simplified mesh without levels was made.
    """

def decode_normal_mesh(data: bytes, level: int) -> NormalMesh:
    """Decode an `.snm` file up to a level, or all of it with -1."""

def optimize_strip_order(triangles: NDArray[np.int32], vertices: int) -> NDArray[np.int32]:
    """Reorder triangles (m, 3) for compression; `vertices` is the vertex count."""

def encode_rows(rows: NDArray[np.uint8]) -> bytes:
    """Encode rows (n, k) of bytes, k a multiple of 4 up to 256, as ATTRIBUTES of EXT_meshopt_compression."""

def decode_rows(packed: bytes, count: int, size: int, filter_name: str) -> bytes:
    """Decode rows of `size` bytes from ATTRIBUTES data; ValueError if the data is damaged."""

def decode_indices(packed: bytes, count: int, size: int, mode: str) -> bytes:
    """Decode indices of 2 or 4 bytes from TRIANGLES or INDICES data; ValueError if it is damaged."""

def encode_triangles(triangles: NDArray[np.int32], vertices: int) -> bytes:
    """Encode triangles (m, 3) as TRIANGLES of EXT_meshopt_compression."""
