"""Sparse TSDF volume in blocks of 8³ voxels along the surface.

Voxels accumulate distances along the surface normal, which each pixel provides. Along the optical axis,
voxels just behind a road seen at a grazing angle would be metres behind it.

References
----------
Curless and Levoy, A Volumetric Method for Building Complex Models from Range Images, 1996.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.codes import MACHINE_OUT_OF_MEMORY
from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.frames.posed_depth import PosedDepth
from scanloom.stages.fusion.codes import FUSE_FRAMES_FAR_APART
from scanloom.stages.scans.model.scan import Camera, ColorImage, Pose
from scanloom.stages.surface.mesh import Mesh

# Voxels along the side of a block.
BLOCK_SIDE = 8
# Bytes per voxel with and without colour: distance, weight, observation count, colour.
_VOXEL_BYTES = {True: 12, False: 7}

# Number of frames that observed each vertex, (n,).
ObservationCounts = NDArray[np.float32]
# Z-order keys of blocks.
BlockKeys = NDArray[np.uint64]
# Box of blocks: inclusive lower and exclusive upper block coordinates.
BlockBox = tuple[tuple[int, int, int], tuple[int, int, int]]


def compute_block_bytes(*, color: bool) -> int:
    """Return the memory of one block of voxels, bytes."""
    return BLOCK_SIDE**3 * _VOXEL_BYTES[color]


class VolumeMemoryError(StageError):
    """The volume would exceed its memory limit."""


def make_memory_error(allowed_bytes: int, voxel_size: float) -> VolumeMemoryError:
    """Build the error for a volume at its memory limit."""
    return VolumeMemoryError(
        MACHINE_OUT_OF_MEMORY,
        "the volume would exceed its memory limit of {allowed_bytes:.0f} MB with voxels of {voxel_size:g} m.",
        remedy="Increase voxel_size or memory, or reduce max_depth.",
        allowed_bytes=allowed_bytes / 1000000.0,
        voxel_size=voxel_size,
    )


@dataclass(frozen=True)
class DepthNoiseModel:
    """Noise model that weights depth measurements.

    The standard deviation at depth z is noise × (1 − growth + growth (z / depth)²). The weight is the inverse
    variance. It falls off behind the surface beyond the noise, because other frames may observe the far side
    of a thin part there.

    Attributes
    ----------
    deviation : standard deviation at the reference depth, metres; above 0.
    reference_depth : reference depth with weight 1, metres.
    growth : 0 if the noise is constant, up to 1 if it grows with squared depth.
    """

    deviation: float
    reference_depth: float = 1.0
    growth: float = 0.0

    def get_coefficients(self) -> tuple[float, float, float]:
        """Return the coefficients of the noise model for the kernel.

        Returns
        -------
        Standard deviation at weight 1 (m), at depth 0 (m), and its growth per squared metre (1/m).
        """
        constant, quadratic = 1 - self.growth, self.growth / self.reference_depth**2
        return self.deviation, self.deviation * constant, self.deviation * quadratic


class TsdfVolume(Protocol):
    """Interface of a TSDF volume."""

    @property
    def bytes(self) -> int:
        """Return the memory of the volume, bytes."""

    def prepare_frame(self, view: PosedDepth, fused_pixels: NDArray[np.bool_], pose: Pose) -> Any:
        """Prepare a frame for `integrate`. Thread-safe; frames may be prepared out of order."""

    def integrate(self, view: PosedDepth, volume_input: Any, pose: Pose, color: ColorImage | None) -> None:
        """Integrate a prepared frame."""

    def compute_median_observations(self) -> float:
        """Return the median observation count of voxels near the surface."""

    def extract_mesh(self, min_weight: int) -> tuple[Mesh, ObservationCounts | None]:
        """Extract the surface through voxels observed by at least `min_weight` frames.

        Returns
        -------
        The mesh in volume coordinates, and the number of frames that observed each vertex (n,), None if
        unknown.
        """


def find_touched_blocks(
    view: PosedDepth,
    fused_pixels: NDArray[np.bool_],
    pose: Pose,
    *,
    voxel_size: float,
    truncation: float,
    within: BlockBox | None = None,
) -> BlockKeys:
    """Find the blocks within the truncation band of a frame.

    Parameters
    ----------
    fused_pixels : (h, w), pixels whose surface is fused; the other pixels only carve free space.
    pose : (4, 4), camera to volume coordinates.
    voxel_size, truncation : metres.
    within : limits the result to a box of blocks.

    Returns
    -------
    Sorted Z-order keys of the blocks.

    Raises
    ------
    StageError
        If the surface is too far from the volume origin for 21-bit block coordinates.
    """
    surface = view.surface
    try:
        return _kernels.find_touched_blocks(
            _to_kernel_view(view.camera, pose),
            surface.depth,
            surface.normal,
            surface.obliqueness,
            fused_pixels,
            voxel_size=voxel_size,
            truncation=truncation,
            within=within,
        )
    except _kernels.LimitError as error:
        reach = (1 << 20) * BLOCK_SIDE * voxel_size
        raise StageError(
            FUSE_FRAMES_FAR_APART,
            (
                "a frame has points more than {reach:.3g} km from the other cameras, beyond the "
                "range of voxels of {voxel_size:g} m."
            ),
            remedy="Check the poses, or increase voxel_size.",
            reach=reach / 1000,
            voxel_size=voxel_size,
        ) from error


class SparseVolume:
    """Sparse TSDF volume, grown by the blocks that frames touch.

    Parameters
    ----------
    voxel_size, truncation : metres; truncation along the surface normal.
    weighing : noise model that weights measurements.
    color : whether voxels store colour.
    max_bytes : memory limit of the volume.
    threads : thread count.
    within : limits the volume to a box of blocks; None for no limit.
    """

    def __init__(
        self,
        voxel_size: float,
        truncation: float,
        noise_model: DepthNoiseModel,
        *,
        color: bool,
        max_bytes: float,
        threads: int,
        within: BlockBox | None = None,
    ) -> None:
        self._within = within
        self._voxel_size = voxel_size
        self._truncation = truncation
        self._noise_model = noise_model
        self._color = color
        self._threads = threads
        self._max_blocks = max(int(max_bytes / compute_block_bytes(color=color)), 1)
        self._volume = _kernels.Volume(voxel_size, truncation, color=color, max_blocks=self._max_blocks)

    @property
    def bytes(self) -> int:
        """Return the memory of the volume, bytes."""
        return self._volume.bytes

    def prepare_frame(self, view: PosedDepth, fused_pixels: NDArray[np.bool_], pose: Pose) -> BlockKeys:
        """Find the blocks that a frame touches; see `find_touched_blocks`."""
        return find_touched_blocks(
            view,
            fused_pixels,
            pose,
            voxel_size=self._voxel_size,
            truncation=self._truncation,
            within=self._within,
        )

    def integrate(
        self, view: PosedDepth, block_keys: BlockKeys, pose: Pose, color: ColorImage | None
    ) -> None:
        """Integrate one frame into the blocks it touches.

        Parameters
        ----------
        block_keys : keys of the touched blocks, as returned by `prepare_frame`.
        pose : (4, 4), camera to volume coordinates. Voxel positions are float32, so the volume origin must be
            close to the camera.
        color : (h, w, 3) uint8 at the size of the depth map; required if voxels store colour.

        Raises
        ------
        StageError
            If the volume would exceed its memory limit.
        """
        if not len(block_keys):
            return
        weighing = self._noise_model
        try:
            self._volume.integrate(
                block_keys,
                _to_kernel_view(view.camera, pose),
                view.surface.depth,
                view.surface.obliqueness,
                color,
                weighing=weighing.get_coefficients(),
                wanted_threads=self._threads,
            )
        except _kernels.LimitError as error:
            raise make_memory_error(
                self._max_blocks * compute_block_bytes(color=self._color), self._voxel_size
            ) from error

    def compute_median_observations(self) -> float:
        """Return the median observation count of voxels near the surface."""
        return compute_histogram_median(self.count_observations(None))

    def count_observations(self, within: BlockBox | None) -> NDArray[np.int64]:
        """Return the histogram (256,) of observation counts near the surface.

        Parameters
        ----------
        within : box of blocks to count in; None for all.
        """
        return self._volume.observation_histogram(within=within).astype(np.int64)

    def extract_mesh(self, min_weight: int) -> tuple[Mesh, ObservationCounts | None]:
        """Extract the surface through voxels observed by at least `min_weight` frames.

        Blocks are in Z-order.

        Returns
        -------
        The mesh in volume coordinates, and the number of frames that observed each vertex (n,). It is the
        mean over both voxels of the vertex's edge, which count up to 255.
        """
        mesh, seen, _ = self.extract_brick_mesh(min_weight, None)
        return mesh, seen

    def extract_brick_mesh(
        self, min_weight: int, within: BlockBox | None
    ) -> tuple[Mesh, ObservationCounts, list[BlockKeys]]:
        """Extract the surface in a box of blocks.

        Returns
        -------
        mesh : triangle indices from the vertex count upward reference vertices owned by adjacent boxes.
        seen : (n,) number of frames that observed each vertex.
        joints : five arrays. Block keys (k,) and edge codes (k,) of the referenced vertices of adjacent
            boxes; block keys (j,), edge codes (j,) and indices (j,) of own vertices that adjacent boxes may
            reference.
        """
        found, joints = self._volume.extract_surface(min_weight, within=within, wanted_threads=self._threads)
        places, triangles, levels, seen = found
        colors = np.rint(levels).astype(np.uint8) if self._color else None
        return Mesh(places * self._voxel_size, triangles, colors), seen, joints


def compute_histogram_median(counts: NDArray[np.int64]) -> float:
    """Return the median of a histogram whose index is the value.

    The median of an empty histogram is 0.
    """
    passed = np.cumsum(counts)
    if not passed[-1]:
        return 0.0
    middle = (passed[-1] - 1) // 2, passed[-1] // 2
    return float(np.searchsorted(passed, middle, side="right").mean())


def _to_kernel_view(
    camera: Camera, pose: Pose
) -> tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]:
    return (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height), np.asarray(
        pose, np.float64
    )
