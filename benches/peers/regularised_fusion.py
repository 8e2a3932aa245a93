"""Fusion of depth maps with a regularised distance field, in place of filtering the mesh.

The volume has the voxel size, truncation, distances and weights of scanloom's fusion, because scanloom's
kernel integrates each frame into a separate volume. The weighted mean of the distances gives scanloom's
mesh. Instead, the field minimises an energy with total variation or second-order total generalised variation
(total_variation.py). The field is on a narrow band of voxels around the surface of the mean.

References
----------
Zach, Pock and Bischof, "A globally optimal algorithm for robust TV-L1 range image integration", 2007; Zach,
"Fast and high quality fusion of depth maps", 2008; Pock, Zebedin and Bischof, "TGV-fusion", 2011.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from peers.data_terms import DataTerm, Floats, Histograms, SquaredDifferences
from peers.total_variation import Positions, VoxelOperators, find_neighbours, minimise
from scanloom.stages import _kernels
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.frames.posed_depth import PosedDepth, read_posed_depth
from scanloom.stages.fusion.crop import select_triangles
from scanloom.stages.fusion.integration import FusionJob, derive_min_observations, prepare_fusion
from scanloom.stages.fusion.params import FuseParams
from scanloom.stages.fusion.tsdf_volume import BLOCK_SIDE, compute_histogram_median, find_touched_blocks
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.surface.mesh import Mesh

_BINS = 8
# Steps from the voxels next to the surface of the mean to the border of the band. Results are the same with 1
# or 3; without any, the surface is torn, because it cannot move.
_BAND_STEPS = 2
# Stored weight of a typical measurement.
_WEIGHT_UNIT = 32
_MAX_BLOCKS = 1_000_000
# Maximum size of the bounding box of the band, a dense array for marching cubes.
_MAX_VOXELS = 60_000_000
_BLOCK_VOXELS = BLOCK_SIDE**3
# Position of each voxel of a block; x is fastest.
_OFFSETS = np.stack(np.unravel_index(np.arange(_BLOCK_VOXELS), (BLOCK_SIDE,) * 3)[::-1], axis=1)


@dataclass(frozen=True, kw_only=True)
class Regulariser:
    """Energy of a regularised field.

    Attributes
    ----------
    name : of the method.
    order : 1 for total variation, 2 for total generalised variation.
    is_robust : True for absolute differences to a histogram, False for squared differences to the mean.
    data_weights : λ to try, in this order.
    """

    name: str
    order: int
    is_robust: bool
    data_weights: tuple[float, ...]


REGULARISERS = (
    Regulariser(name="TV-L1", order=1, is_robust=True, data_weights=(0.3, 1, 3)),
    Regulariser(name="TGV-L1", order=2, is_robust=True, data_weights=(0.1, 0.3, 1, 3)),
    Regulariser(name="TGV-L2", order=2, is_robust=False, data_weights=(0.3, 1, 3, 10)),
)


@dataclass(frozen=True, eq=False)
class MeasuredBand:
    """Observed voxels around the surface, with their measurements.

    Attributes
    ----------
    positions : (n, 3) voxel coordinates.
    histograms : measured distances, voxels; weight 1 is a typical measurement.
    is_sure : (n,) True for voxels that enough frames have observed.
    voxel_size : metres.
    origin : (3,) world coordinates of voxel 0.
    """

    positions: Positions
    histograms: Histograms
    is_sure: NDArray[np.bool_]
    voxel_size: float
    origin: NDArray[np.float64]


def measure_band(scan: Scan) -> MeasuredBand:
    """Collect the measurements of the voxels around the surface.

    Parameters
    ----------
    scan : at least two frames with depth and poses.
    """
    job = prepare_fusion(scan, FuseParams())
    whole = _create_volume(job)
    for view in _read_views(job):
        _integrate(job, whole, view)
    median_count = compute_histogram_median(whole.observation_histogram(within=None).astype(np.int64))
    min_observations = derive_min_observations(median_count, job.frames)
    blocks, distances, weights, counts, _ = whole.copy_voxels()
    observed = np.flatnonzero(weights)
    positions = (blocks[:, None, :] * BLOCK_SIDE + _OFFSETS).reshape(-1, 3)[observed].astype(np.int32)
    band = find_band(positions, distances.ravel()[observed] >= 0)
    chosen = observed[band]
    slots = {tuple(block): slot for slot, block in enumerate(blocks.tolist())}
    indices = np.full(weights.shape, -1)
    indices.ravel()[chosen] = np.arange(len(chosen))
    histograms = _collect_histograms(job, slots, indices, len(chosen))
    return MeasuredBand(
        positions[band],
        histograms,
        counts.ravel()[chosen] >= min_observations,
        job.plan.voxel_size,
        job.plan.origin,
    )


def find_band(positions: Positions, is_front: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Find the voxels (k,) around changes of sign, ascending.

    Parameters
    ----------
    positions : (n, 3) voxel coordinates.
    is_front : (n,) True in front of the surface, False behind it.
    """
    following = find_neighbours(positions)
    pairs = np.concatenate([np.stack([np.flatnonzero(k >= 0), k[k >= 0]]) for k in following], axis=1)
    is_near = np.zeros(len(positions), bool)
    is_near[pairs[:, is_front[pairs[0]] != is_front[pairs[1]]]] = True
    for _ in range(_BAND_STEPS):
        is_near[pairs[:, is_near[pairs].any(axis=0)]] = True
    return np.flatnonzero(is_near)


def _collect_histograms(
    job: FusionJob, slots: dict[tuple[int, ...], int], indices: NDArray[np.int64], count: int
) -> Histograms:
    """Integrate each frame alone, and collect the distances.

    Parameters
    ----------
    slots : row of each block in `indices`.
    indices : (blocks, 512) index of each voxel in the band; −1 outside.
    count : number of voxels in the band.
    """
    sums, weights = (np.zeros((_BINS, count), np.float32) for _ in range(2))
    for view in _read_views(job):
        single = _create_volume(job)
        _integrate(job, single, view)
        blocks, distances, own_weights, _, _ = single.copy_voxels()
        voxels = indices[[slots[tuple(block)] for block in blocks.tolist()]]
        is_used = (own_weights > 0) & (voxels >= 0)
        values, amounts = distances[is_used], own_weights[is_used] / np.float32(_WEIGHT_UNIT)
        bins = np.clip((values + 1) * (_BINS / 2), 0, _BINS - 1).astype(np.int64)
        # A frame has each voxel once, so that no index repeats.
        sums[bins, voxels[is_used]] += amounts * values
        weights[bins, voxels[is_used]] += amounts
    centers = (np.arange(_BINS, dtype=np.float32) + 0.5) * (2 / _BINS) - 1
    levels = np.repeat(centers[:, None], count, axis=1)
    np.divide(sums, weights, out=levels, where=weights > 0)
    return Histograms(levels * np.float32(job.plan.truncation / job.plan.voxel_size), weights)


def _read_views(job: FusionJob) -> Iterator[PosedDepth]:
    for frame in job.frames:
        with contextlib.suppress(InputError):
            yield read_posed_depth(frame, job.plan.limits)


def _create_volume(job: FusionJob) -> _kernels.Volume:
    return _kernels.Volume(job.plan.voxel_size, job.plan.truncation, color=False, max_blocks=_MAX_BLOCKS)


def _integrate(job: FusionJob, volume: _kernels.Volume, view: PosedDepth) -> None:
    plan, camera = job.plan, view.camera
    pose = plan.to_local_pose(view.pose)
    blocks = find_touched_blocks(
        view, plan.mask_fused_pixels(view), pose, voxel_size=plan.voxel_size, truncation=plan.truncation
    )
    pinhole = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height)
    volume.integrate(
        blocks,
        (pinhole, np.ascontiguousarray(pose, np.float64)),
        view.surface.depth,
        view.surface.obliqueness,
        None,
        weighing=plan.noise_model.get_coefficients(),
        wanted_threads=job.threads,
    )


def fuse_regularised(
    band: MeasuredBand, operators: VoxelOperators, regulariser: Regulariser, data_weight: float
) -> Mesh:
    """Fuse with a regularised field.

    Parameters
    ----------
    operators : of the positions of the band.
    data_weight : λ.
    """
    data: DataTerm = band.histograms
    if not regulariser.is_robust:
        data = SquaredDifferences.from_histograms(band.histograms)
    return extract_mesh(band, minimise(operators, data, data_weight, order=regulariser.order))


def extract_mesh(band: MeasuredBand, field: Floats) -> Mesh:
    """Extract the surface of a field (n,) of distances; normals point to positive distances.

    Raises
    ------
    ValueError
        If the bounding box of the voxels is too large for a dense array.
    """
    import skimage.measure

    if not field.min() < 0 < field.max():
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    low = band.positions.min(axis=0)
    size = band.positions.max(axis=0) - low + 1
    if np.prod(size, dtype=np.int64) > _MAX_VOXELS:
        raise ValueError(f"the volume of {size} voxels exceeds the limit of {_MAX_VOXELS:,}")
    at = tuple((band.positions - low).T)
    dense = np.ones(size, np.float32)
    dense[at] = field
    is_sure = np.zeros(size, bool)
    is_sure[at] = band.is_sure
    vertices, triangles, _, _ = skimage.measure.marching_cubes(dense, 0, gradient_direction="descent")
    # A cube has triangles only if all its corners are sure.
    for axis in range(3):
        is_sure[_select(axis, slice(-1))] &= is_sure[_select(axis, slice(1, None))]
        is_sure[_select(axis, slice(-1, None))] = False
    cubes = np.floor(vertices[triangles].mean(axis=1)).astype(np.int64)
    mesh = Mesh((vertices + low) * band.voxel_size + band.origin, triangles.astype(np.int32))
    return select_triangles(mesh, is_sure[tuple(cubes.T)])


def _select(axis: int, part: slice) -> tuple[slice, ...]:
    return tuple(part if k == axis else slice(None) for k in range(3))
