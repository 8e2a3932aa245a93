"""Fields of parameter classes as keywords of functions, for type checkers.

Written by `PYTHONPATH=.:docs python -m making.keywords`; do not edit.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypedDict

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from scanloom.stages.diagnostics.diagnostic import Diagnostic
    from scanloom.stages.simplification.certified.params import CertifiedParams
    from scanloom.stages.simplification.jia01.params import Jia01Params
    from scanloom.stages.simplification.planar.params import PlanarParams
    from scanloom.stages.simplification.seams.params import SeamsParams
    from scanloom.stages.stereo.params import SgbmParams
    from scanloom.stages.surface.mesh import Colors, Triangles, Vertices
    from scanloom.stages.surface.texture import Texture


class AdjustKeywords(TypedDict, total=False):
    """Fields of `AdjustParams`."""

    enabled: bool | None
    camera: bool | None
    shutter: bool | None
    depth: bool | None
    pose_sigma: float


class BakeKeywords(TypedDict, total=False):
    """Fields of `BakeParams`."""

    normal_map: bool
    occlusion_map: bool
    occlusion_distance: float | None
    displacement_map: bool
    texel_size: float | None
    max_size: int
    max_texels: float
    padding: int | None
    samples: int | None


class CertifiedKeywords(TypedDict, total=False):
    """Fields of `CertifiedParams`."""

    tight_bounds: bool


class CertifyKeywords(TypedDict, total=False):
    """Fields of `CertifyParams`."""

    shape_tolerance: float
    color_tolerance: float
    color_floor: float
    max_shape: float | None
    max_color: float | None
    check_only: bool
    effort: float
    slack: float | None
    threads: int


class ChangeKeywords(TypedDict, total=False):
    """Fields of `ChangeParams`."""

    change_distance: float | None
    change_area: float


class CheckKeywords(TypedDict, total=False):
    """Fields of `CheckParams`."""

    corner_angle: float
    fold_angle: float
    spike_angle: float
    min_thickness: float
    threads: int | None


class CleanKeywords(TypedDict, total=False):
    """Fields of `CleanParams`."""

    min_island_area: float | None
    keep_largest: bool
    fill_holes: float
    solid: bool
    wall: float
    min_thickness: float
    stitch: bool
    weld_distance: float
    repair: bool
    repair_angle: float
    max_shape: float | None


class CompareKeywords(TypedDict, total=False):
    """Fields of `CompareParams`."""

    samples: int
    seed: int


class CoverageKeywords(TypedDict, total=False):
    """Fields of `CoverageParams`."""

    few_frames: int | None
    max_angle: float
    max_distance: float | None
    spread: float | None
    min_area: float | None
    max_patch_size: float | None
    spacing: float | None
    max_defects: int


class DepthKeywords(TypedDict, total=False):
    """Fields of `DepthParams`."""

    min_depth: float | None
    max_depth: float | None
    max_relative_depth_error: float
    disparity_sigma: float
    min_confidence: int | None
    matcher: str
    model: str | None
    model_error: float
    model_memory: float
    model_seconds: float
    disparities: int | None
    left_right_tolerance: float
    speckle_size: int
    speckle_range: float
    min_texture: float
    refine: bool
    views: str
    partners: int
    min_consistent_views: int
    consistency_tolerance: float | None
    max_backdrop_contrast: float
    fill_from_visual_hull: bool
    fill_from_planes: bool
    max_side: int
    max_pose_error: float
    fix_upside_down: bool
    max_skipped_ratio: float
    threads: int | None
    sgbm: SgbmParams | SgbmKeywords


class DeviationKeywords(TypedDict, total=False):
    """Fields of `DeviationParams`."""

    tolerance: float | None
    signed_samples: int
    color_range: float | None
    palette: str


class ExportKeywords(TypedDict, total=False):
    """Fields of `ExportParams`."""

    up: str | None
    axes: str
    unit: str
    on_floor: bool
    compress: str
    position_bits: int
    texel_steps: int
    shading: str
    images: str
    quality: int
    image_size: int
    hollow: float
    drain: float
    plate: float
    bed: tuple[float, float, float] | None
    watertight: bool


class FuseKeywords(TypedDict, total=False):
    """Fields of `FuseParams`."""

    voxel_size: float | None
    voxel_factor: float
    truncation: float | None
    min_depth: float
    max_depth: float | None
    max_jump: float
    max_angle: float | None
    min_weight: int | None
    box: tuple[float, float, float, float, float, float] | None
    radius: float | None
    center: tuple[float, float, float] | None
    remove_plane: bool
    plane_margin: float | None
    upsample: str
    upsample_factor: int
    color: bool
    max_skipped_ratio: float
    memory: float
    brick_size: float | None
    backend: str
    device: str


class Jia01Keywords(TypedDict, total=False):
    """Fields of `Jia01Params`."""

    resolution: float | None
    paper_rule: bool


class LevelsKeywords(TypedDict, total=False):
    """Fields of `LevelsParams`."""

    first_error: float | None
    ratio: float
    cell_triangles: int
    root_triangles: int
    drop_islands: float
    threads: int | None


class LodKeywords(TypedDict, total=False):
    """Fields of `LodParams`."""

    first_error: float | None
    ratio: float
    cell_triangles: int
    root_triangles: int
    drop_islands: float
    threads: int | None
    base_error: float


class MeshKeywords(TypedDict, total=False):
    """Fields of `Mesh`."""

    vertices: Vertices
    triangles: Triangles
    colors: Colors | None
    normals: NDArray[np.float64] | None
    texture: Texture | None
    corner_normals: NDArray[np.float64] | None
    part_ids: NDArray[np.int32] | None
    part_names: tuple[str, ...]
    diagnostics: tuple[Diagnostic, ...]
    up: tuple[float, float, float] | None
    intensity_max: float | None


class PatchKeywords(TypedDict, total=False):
    """Fields of `PatchParams`."""

    patch_angle: float
    crease_angle: float
    noise_angle: float
    max_shape: float | None
    max_color: float | None
    threads: int | None


class PlanarKeywords(TypedDict, total=False):
    """Fields of `PlanarParams`."""

    patch_angle: float
    crease_angle: float
    noise_angle: float


class ReadingKeywords(TypedDict, total=False):
    """Fields of `ReadingParams`."""

    intrinsics: str | None
    baseline: float | None
    calibration: str | None
    poses: str | None
    pose_convention: str
    poses_by_order: bool
    masks: str | None
    adjusted_cameras: str | None
    depth_calibration: str | None
    depth_scale: float | None
    min_confidence: int | None
    align_axes: bool
    keep_unposed: bool
    check_poses: bool
    first: int
    last: int | None
    every: int
    max_frames: int | None
    hold_out: int | None


class RefineKeywords(TypedDict, total=False):
    """Fields of `RefineParams`."""

    strength: float
    planes: bool
    fill_holes: float | None


class RegisterKeywords(TypedDict, total=False):
    """Fields of `RegisterParams`."""

    enabled: bool | None
    max_depth: float | None
    refine: bool
    piece: int
    subject: str
    focal: bool
    loops: bool


class RemeshKeywords(TypedDict, total=False):
    """Fields of `RemeshParams`."""

    levels: int | None
    base_triangles: int | None
    base_error: float | None
    max_error: float | None
    scheme: str
    relaxations: int
    tangential_steps: int
    threads: int | None
    tolerance: float | None
    color_tolerance: float


class RepairKeywords(TypedDict, total=False):
    """Fields of `RepairParams`."""

    max_shape: float | None
    corner_angle: float
    fold_angle: float
    spike_angle: float
    threads: int | None


class ReplayKeywords(TypedDict, total=False):
    """Fields of `ReplayParams`."""

    triangles: int | None
    ratio: float | None
    collapses: int | None
    fit: bool


class ScanKeywords(TypedDict, total=False):
    """Fields of `ScanParams`."""

    intrinsics: str | None
    baseline: float | None
    calibration: str | None
    poses: str | None
    pose_convention: str
    poses_by_order: bool
    masks: str | None
    adjusted_cameras: str | None
    depth_calibration: str | None
    depth_scale: float | None
    min_confidence: int | None
    align_axes: bool
    keep_unposed: bool
    check_poses: bool
    first: int
    last: int | None
    every: int
    max_frames: int | None
    hold_out: int | None
    layout: str | None
    scale: float | None
    known_distance: str | None
    tag_size: float | None
    tag_family: str


class SeamsKeywords(TypedDict, total=False):
    """Fields of `SeamsParams`."""

    similar_distance: float | None
    texture_weight: float
    normal_weight: float
    shape_weight: float
    material_border_penalty: float
    part_border_penalty: float
    valence_penalty: float
    duplicate_penalty: float
    max_seam_drift: float | None


class SgbmKeywords(TypedDict, total=False):
    """Fields of `SgbmParams`."""

    block_size: int
    p1: int | None
    p2: int | None
    prefilter_cap: int
    uniqueness: int | None
    left_right: str
    smooth: bool
    smooth_lambda: float
    smooth_sigma: float


class SharedKeywords(TypedDict, total=False):
    """Fields of `SharedParams`."""

    triangles: int | None
    ratio: float | None
    max_shape: float | None
    max_color: float | None
    noise_factor: float
    drop_below: float | None
    attribute_scale: float | None
    fit: bool
    keep_uv: bool
    bake: bool | None
    threads: int | None


class SimplifyKeywords(TypedDict, total=False):
    """Fields of `SimplifyParams`."""

    triangles: int | None
    ratio: float | None
    max_shape: float | None
    max_color: float | None
    noise_factor: float
    drop_below: float | None
    attribute_scale: float | None
    fit: bool
    keep_uv: bool
    bake: bool | None
    threads: int | None
    method: str
    certified: CertifiedParams | CertifiedKeywords
    seams: SeamsParams | SeamsKeywords
    jia01: Jia01Params | Jia01Keywords
    planar: PlanarParams | PlanarKeywords


class SimulationKeywords(TypedDict, total=False):
    """Fields of `SimulationParams`."""

    density: float
    split: str
    collision: str
    max_excess: float | None


class StructureKeywords(TypedDict, total=False):
    """Fields of `StructureParams`."""

    max_megapixels: float
    max_frames: int


class TextureKeywords(TypedDict, total=False):
    """Fields of `TextureParams`."""

    texels_per_pixel: float
    max_size: int
    max_texels: float
    format: str
    quality: int
    padding: int
    views: int
    exposure: bool
    alignment_iterations: int


class TileImageKeywords(TypedDict, total=False):
    """Fields of `TileImageParams`."""

    texels_per_error: float
    image_side: int
    image_format: str
    image_quality: int


class TilesKeywords(TypedDict, total=False):
    """Fields of `TilesParams`."""

    up: str | None
    compress: str


class TradeoffKeywords(TypedDict, total=False):
    """Fields of `TradeoffParams`."""

    steps: int
    min_ratio: float
    max_distance: float | None
    samples: int
    glb_bytes: bool


class ViewsKeywords(TypedDict, total=False):
    """Fields of `ViewsParams`."""

    views: int
    view_width: int
