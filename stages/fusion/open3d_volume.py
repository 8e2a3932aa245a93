"""TSDF volume backed by Open3D's VoxelBlockGrid, for CUDA devices and for comparison.

Open3D measures the distance of a voxel to the surface along the optical axis. At a grazing angle this is many
times the true distance. Voxels just behind a road are then metres behind it along the axis, leave the
truncation band, and the road is torn. Each depth map is therefore integrated in layers of similar
obliqueness, with the truncation stretched per layer. Open3D stores distance divided by truncation, so voxels
accumulate the distance along the surface normal consistently over layers and frames.

References
----------
Curless and Levoy, A Volumetric Method for Building Complex Models from Range Images, 1996.
Dong, Park, Yang and Kaess, ASH: A Modern Framework for Parallel Spatial Hashing in 3D Perception, 2022.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.tsdf_volume import BLOCK_SIDE, make_memory_error
from scanloom.stages.scans.model.scan import ColorImage, Pose
from scanloom.stages.surface.mesh import Mesh

# Bytes per voxel with and without colour: distance, weight and three colour channels in float32.
_VOXEL_BYTES = {True: 20, False: 8}
# Ratio of obliqueness between layers. It keeps the truncation along the normal within a factor of √3 of the
# requested value. Nearly all pixels of an indoor scan are in one layer.
_LAYER_OBLIQUENESS_RATIO = 3.0
# Pixel spacing on the surface for finding touched blocks, relative to the block size.
_SAMPLE_SPACING = 0.5
# Minimum absolute distance of a voxel to the surface, in voxels. Zero would put the vertices of several edges
# at one point, which creates triangles without area and leaves the order of vertices undefined.
_MIN_DISTANCE = 1e-3


@dataclass(frozen=True, eq=False)
class ObliquenessLayer:
    """Pixels of a depth map with similar obliqueness.

    Attributes
    ----------
    depth : (h, w) uint16 in units of max_depth / 65535; 0 at all other pixels.
    points : (n, 3) float32 metres, camera coordinates; sample of the truncation band to allocate.
    stretch : truncation along the optical axis divided by truncation along the normal.
    """

    depth: NDArray[np.uint16]
    points: NDArray[np.float32]
    stretch: float


def split_by_obliqueness(
    view: PosedDepth,
    fused_pixels: NDArray[np.bool_],
    *,
    voxel_size: float,
    truncation: float,
    max_depth: float,
) -> list[ObliquenessLayer]:
    """Split a depth map into layers of similar obliqueness.

    Parameters
    ----------
    fused_pixels : (h, w), pixels whose surface is fused; the other pixels only carve free space.
    voxel_size, truncation : metres; truncation along the surface normal.
    max_depth : metres; farther depth is dropped.
    """
    surface = view.surface
    valid = (surface.depth > 0) & (surface.depth <= max_depth)
    level = np.where(valid, np.int8(0), np.int8(-1))
    steepest = float(surface.obliqueness[valid].max(initial=1))
    for k in range(1, int(math.log(steepest, _LAYER_OBLIQUENESS_RATIO)) + 1):
        level += valid & (surface.obliqueness >= _LAYER_OBLIQUENESS_RATIO**k)
    depth = np.where(valid, np.rint(surface.depth * np.float32(65535 / max_depth)), 0).astype(np.uint16)
    sample = _sample_pixels(view, _SAMPLE_SPACING * BLOCK_SIDE * voxel_size)
    result = []
    for k in range(int(level.max()) + 1):
        here = level == k
        points = _sample_truncation_band(view, here & sample & fused_pixels, truncation)
        if len(points):
            result.append(
                ObliquenessLayer(
                    np.where(here, depth, np.uint16(0)), points, _LAYER_OBLIQUENESS_RATIO ** (k + 0.5)
                )
            )
    return result


def _sample_pixels(view: PosedDepth, spacing: float) -> NDArray[np.bool_]:
    """Sample pixels at most `spacing` metres apart on the surface.

    The stride is 1, 2, 4 or 8 pixels.
    """
    apart = view.surface.depth * view.surface.obliqueness * np.float32(1 / view.camera.fx)
    chosen = np.zeros(apart.shape, bool)
    for step in (8, 4, 2, 1):
        grid = np.s_[::step, ::step]
        chosen[grid] |= apart[grid] > (spacing / (2 * step) if step < 8 else 0)
    return chosen


def _sample_truncation_band(
    view: PosedDepth, mask: NDArray[np.bool_], truncation: float
) -> NDArray[np.float32]:
    """Sample the truncation band around the surface.

    Returns
    -------
    (3 · n, 3) metres, camera coordinates: points on the surface, and points half a truncation in front of it
    and behind it along the normal.
    """
    rows, columns = np.nonzero(mask)
    on = view.unproject_to_camera(rows, columns)
    normal = np.stack([axis[rows, columns] for axis in view.surface.normal], axis=1)
    offset = normal * (np.float32(truncation / 2) / view.surface.obliqueness[rows, columns])[:, None]
    return np.concatenate([on, on + offset, on - offset])


def _transform_points(points: NDArray[np.float32], pose: Pose) -> NDArray[np.float32]:
    return np.asarray(points @ pose[:3, :3].T.astype(np.float32) + pose[:3, 3].astype(np.float32))


class Open3DVolume:
    """TSDF volume in Open3D's VoxelBlockGrid.

    Each depth map is integrated in layers of similar obliqueness, see `split_by_obliqueness`. Blocks are
    allocated when a layer first reaches them.

    Parameters
    ----------
    voxel_size, truncation : metres; truncation along the surface normal.
    max_depth : metres, the maximum depth of any layer.
    color : True if voxels store colour.
    blocks : initial capacity in blocks.
    max_bytes : memory limit of the volume.
    device : "CPU:0" or "CUDA:0".
    """

    def __init__(
        self,
        voxel_size: float,
        truncation: float,
        max_depth: float,
        *,
        color: bool,
        blocks: int,
        max_bytes: float,
        device: str,
    ) -> None:
        o3d = import_open3d()
        self._voxel_size = voxel_size
        self._truncation = truncation
        self._depth_scale = 65535 / max_depth
        self._device = o3d.core.Device(device)
        self._max_depth = max_depth
        self._block_bytes = BLOCK_SIDE**3 * _VOXEL_BYTES[color]
        self._max_blocks = max(int(max_bytes / self._block_bytes), 1)
        names = ("tsdf", "weight", "color") if color else ("tsdf", "weight")
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            attr_names=names,
            attr_dtypes=(o3d.core.float32,) * len(names),
            attr_channels=((1), (1), (3))[: len(names)],
            voxel_size=voxel_size,
            block_resolution=BLOCK_SIDE,
            block_count=min(max(blocks, 1), self._max_blocks),
            device=self._device,
        )

    @property
    def blocks(self) -> int:
        """Return the number of allocated blocks in use."""
        return int(self._grid.hashmap().size())

    @property
    def bytes(self) -> int:
        """Return the memory of the volume, including unused capacity."""
        return int(self._grid.hashmap().capacity()) * self._block_bytes

    def prepare_frame(
        self,
        view: PosedDepth,
        fused_pixels: NDArray[np.bool_],
        pose: Pose,  # noqa: ARG002
    ) -> list[ObliquenessLayer]:
        """Prepare the depth layers of a frame; see `split_by_obliqueness`."""
        return split_by_obliqueness(
            view,
            fused_pixels,
            voxel_size=self._voxel_size,
            truncation=self._truncation,
            max_depth=self._max_depth,
        )

    def integrate(
        self, view: PosedDepth, layers: list[ObliquenessLayer], pose: Pose, color: ColorImage | None
    ) -> None:
        """Integrate one frame.

        Parameters
        ----------
        layers : layers, as returned by `prepare_frame`.
        pose : (4, 4), camera to volume coordinates. The volume is float32, so the volume origin must be close
            to the camera.
        color : (h, w, 3) uint8 at the size of the depth map; required if voxels store colour.

        Raises
        ------
        StageError
            If the volume would exceed its memory limit.
        """
        o3d = import_open3d()
        extrinsic = o3d.core.Tensor(np.linalg.inv(pose))
        # Open3D truncates projected pixel coordinates instead of rounding them.
        matrix = view.camera.matrix
        matrix[:2, 2] += 0.5
        intrinsic = o3d.core.Tensor(matrix)
        images = [] if color is None else [self._to_open3d_image(color)]
        for part in layers:
            blocks = self._allocate_touched_blocks(_transform_points(part.points, pose))
            stretch = part.stretch * self._truncation / self._voxel_size
            depth = self._to_open3d_image(part.depth)
            self._grid.integrate(
                blocks, depth, *images, intrinsic, extrinsic, self._depth_scale, math.inf, stretch
            )

    def _to_open3d_image(self, pixels: NDArray[Any]) -> Any:
        o3d = import_open3d()
        return o3d.t.geometry.Image(o3d.core.Tensor(pixels, device=self._device))

    def _allocate_touched_blocks(self, points: NDArray[np.float32]) -> Any:
        o3d = import_open3d()
        cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(points, device=self._device))
        touched = self._grid.compute_unique_block_coordinates(cloud, 0.0)
        self._reserve_blocks(len(touched))
        return touched

    def _reserve_blocks(self, block_count: int) -> None:
        """Grow the capacity by half if `block_count` blocks might not fit.

        Open3D itself would double the capacity.
        """
        blocks = self._grid.hashmap()
        needed = blocks.size() + block_count
        if needed <= blocks.capacity():
            return
        if needed > self._max_blocks:
            raise make_memory_error(self._max_blocks * self._block_bytes, self._voxel_size)
        blocks.reserve(min(max(needed, blocks.capacity() * 3 // 2), self._max_blocks))

    def compute_median_observations(self) -> float:
        """Return the observation count of the median voxel near the surface."""
        used = self._count_used_blocks()
        # Every seventh voxel of each block suffices for a median, and the sample is independent of the block
        # order.
        weight, distance = (
            self._grid.attribute(name)[:used].cpu().numpy().reshape(used, BLOCK_SIDE**3)[:, ::7]
            for name in ("weight", "tsdf")
        )
        near = weight[(weight > 0) & (np.abs(distance) < 0.5)]
        return float(np.median(near)) if len(near) else 0.0

    def extract_mesh(self, min_weight: int) -> tuple[Mesh, None]:
        """Extract the surface through voxels observed at least `min_weight` times.

        Open3D's vertex order depends on thread timing. Vertices are sorted by position, so that equal volumes
        give equal arrays. Observation counts per vertex are not available (None).
        """
        self._clamp_small_distances()
        extracted = self._grid.extract_triangle_mesh(min_weight - 0.5).cpu()
        if "indices" not in extracted.triangle or len(extracted.triangle.indices) == 0:
            return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), None
        vertices = extracted.vertex.positions.numpy()
        triangles = extracted.triangle.indices.numpy()
        order = self._order_vertices(vertices)
        colors = None
        if "colors" in extracted.vertex:
            colors = np.rint(extracted.vertex.colors.numpy()[order] * 255).clip(0, 255).astype(np.uint8)
        rank = np.empty(len(order), np.int32)
        rank[order] = np.arange(len(order), dtype=np.int32)
        return Mesh(
            vertices[order].astype(np.float64), _canonicalise_triangles(rank[triangles]), colors
        ), None

    def _count_used_blocks(self) -> int:
        """Return the used length of the block buffer."""
        active = self._grid.hashmap().active_buf_indices()
        return int(active.cpu().numpy().max(initial=-1)) + 1

    def _clamp_small_distances(self) -> None:
        min_distance = np.float32(_MIN_DISTANCE * self._voxel_size / self._truncation)
        tsdf = self._grid.attribute("tsdf")
        for start in range(0, self._count_used_blocks(), 1024):
            part = tsdf[start : start + 1024]
            distance = part.cpu().numpy()
            distance[np.abs(distance) < min_distance] = min_distance
            if not part.is_cpu:
                tsdf[start : start + 1024] = import_open3d().core.Tensor(distance, device=self._device)

    def _order_vertices(self, vertices: NDArray[np.float32]) -> NDArray[np.int64]:
        """Return an order of vertices by block, then by coordinates.

        Neighbours in space are then close in memory.
        """
        cell = np.floor(vertices / np.float32(BLOCK_SIDE * self._voxel_size)).astype(np.int64)
        block = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
        return np.lexsort((vertices[:, 2], vertices[:, 1], vertices[:, 0], block))


def _canonicalise_triangles(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    """Rotate triangles to start at their smallest index, and sort them."""
    first = triangles.argmin(axis=1)[:, None]
    turned = np.take_along_axis(triangles, (first + np.arange(3)) % 3, axis=1)
    return np.ascontiguousarray(turned[np.lexsort((turned[:, 2], turned[:, 1], turned[:, 0]))])
