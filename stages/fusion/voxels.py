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
BLOCK = 8
# Bytes per voxel with and without colour: distance, weight, observation count, colour.
_VOXEL_BYTES = {True: 12, False: 7}

# Number of frames that observed each vertex, (n,).
Seen = NDArray[np.float32]
# Z-order keys of blocks.
Keys = NDArray[np.uint64]
# Box of blocks: inclusive lower and exclusive upper block coordinates.
Box = tuple[tuple[int, int, int], tuple[int, int, int]]


def block_bytes(*, color: bool) -> int:
    """Return the memory of one block of voxels, bytes."""
    return BLOCK**3 * _VOXEL_BYTES[color]


class OutgrownError(StageError):
    """The volume would exceed its memory limit."""


def outgrown(allowed_bytes: int, voxel_size: float) -> OutgrownError:
    """Build the error for a volume at its memory limit."""
    return OutgrownError(
        MACHINE_OUT_OF_MEMORY,
        "the volume would exceed its memory limit of {allowed_bytes:.0f} MB with voxels of {voxel_size:g} m.",
        remedy="Increase voxel_size or memory, or reduce max_depth.",
        allowed_bytes=allowed_bytes / 1000000.0,
        voxel_size=voxel_size,
    )


@dataclass(frozen=True)
class Weighing:
    """Noise model that weights depth measurements.

    The standard deviation at depth z is noise × (1 − growth + growth (z / depth)²). The weight is the inverse
    variance. It falls off behind the surface beyond the noise, because other frames may observe the far side
    of a thin part there.

    Attributes
    ----------
    noise : standard deviation at the reference depth, metres; above 0.
    depth : reference depth with weight 1, metres.
    growth : 0 if the noise is constant, up to 1 if it grows with squared depth.
    """

    noise: float
    depth: float = 1.0
    growth: float = 0.0

    def deviations(self) -> tuple[float, float, float]:
        """Return the coefficients of the noise model for the kernel.

        Returns
        -------
        Standard deviation at weight 1 (m), at depth 0 (m), and its growth per squared metre (1/m).
        """
        constant, quadratic = 1 - self.growth, self.growth / self.depth**2
        return self.noise, self.noise * constant, self.noise * quadratic


class Field(Protocol):
    """Interface of a TSDF volume."""

    @property
    def bytes(self) -> int:
        """Return the memory of the volume, bytes."""

    def prepared(self, view: PosedDepth, wanted: NDArray[np.bool_], pose: Pose) -> Any:
        """Prepare a frame for `integrate`. Thread-safe; frames may be prepared out of order."""

    def integrate(self, view: PosedDepth, parts: Any, pose: Pose, color: ColorImage | None) -> None:
        """Integrate a prepared frame."""

    def typical_frames(self) -> float:
        """Return the median observation count of voxels near the surface."""

    def mesh(self, min_weight: int) -> tuple[Mesh, Seen | None]:
        """Extract the surface through voxels observed by at least `min_weight` frames.

        Returns
        -------
        The mesh in volume coordinates, and the number of frames that observed each vertex (n,), None if
        unknown.
        """


def touched_blocks(
    view: PosedDepth,
    wanted: NDArray[np.bool_],
    pose: Pose,
    *,
    voxel_size: float,
    truncation: float,
    within: Box | None = None,
) -> Keys:
    """Find the blocks within the truncation band of a frame.

    Parameters
    ----------
    wanted : (h, w), pixels whose surface is fused; the other pixels only carve free space.
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
        return _kernels.touched_blocks(
            _posed(view.camera, pose),
            surface.depth,
            surface.normal,
            surface.obliqueness,
            wanted,
            voxel_size=voxel_size,
            truncation=truncation,
            within=within,
        )
    except _kernels.LimitError as error:
        reach = (1 << 20) * BLOCK * voxel_size
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


class Volume:
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
        weighing: Weighing,
        *,
        color: bool,
        max_bytes: float,
        threads: int,
        within: Box | None = None,
    ) -> None:
        self._within = within
        self._voxel_size = voxel_size
        self._truncation = truncation
        self._weighing = weighing
        self._color = color
        self._threads = threads
        self._max_blocks = max(int(max_bytes / block_bytes(color=color)), 1)
        self._field = _kernels.Volume(voxel_size, truncation, color=color, most_blocks=self._max_blocks)

    @property
    def bytes(self) -> int:
        """Return the memory of the volume, bytes."""
        return self._field.bytes

    def prepared(self, view: PosedDepth, wanted: NDArray[np.bool_], pose: Pose) -> Keys:
        """Find the blocks that a frame touches; see `touched_blocks`."""
        return touched_blocks(
            view,
            wanted,
            pose,
            voxel_size=self._voxel_size,
            truncation=self._truncation,
            within=self._within,
        )

    def integrate(self, view: PosedDepth, parts: Keys, pose: Pose, color: ColorImage | None) -> None:
        """Integrate one frame into the blocks it touches.

        Parameters
        ----------
        parts : keys of the touched blocks, as returned by `prepared`.
        pose : (4, 4), camera to volume coordinates. Voxel positions are float32, so the volume origin must be
            close to the camera.
        color : (h, w, 3) uint8 at the size of the depth map; required if voxels store colour.

        Raises
        ------
        StageError
            If the volume would exceed its memory limit.
        """
        if not len(parts):
            return
        weighing = self._weighing
        try:
            self._field.integrate(
                parts,
                _posed(view.camera, pose),
                view.surface.depth,
                view.surface.obliqueness,
                color,
                weighing=weighing.deviations(),
                wanted_threads=self._threads,
            )
        except _kernels.LimitError as error:
            raise outgrown(self._max_blocks * block_bytes(color=self._color), self._voxel_size) from error

    def typical_frames(self) -> float:
        """Return the median observation count of voxels near the surface."""
        return median_of(self.frame_counts(None))

    def frame_counts(self, within: Box | None) -> NDArray[np.int64]:
        """Return the histogram (256,) of observation counts near the surface.

        Parameters
        ----------
        within : box of blocks to count in; None for all.
        """
        return self._field.frame_counts(within=within).astype(np.int64)

    def mesh(self, min_weight: int) -> tuple[Mesh, Seen | None]:
        """Extract the surface through voxels observed by at least `min_weight` frames.

        Blocks are in Z-order.

        Returns
        -------
        The mesh in volume coordinates, and the number of frames that observed each vertex (n,). It is the
        mean over both voxels of the vertex's edge, which count up to 255.
        """
        mesh, seen, _ = self.surface(min_weight, None)
        return mesh, seen

    def surface(self, min_weight: int, within: Box | None) -> tuple[Mesh, Seen, list[Keys]]:
        """Extract the surface in a box of blocks.

        Returns
        -------
        mesh : triangle indices from the vertex count upward reference vertices owned by adjacent boxes.
        seen : (n,) number of frames that observed each vertex.
        joints : five arrays. Block keys (k,) and edge codes (k,) of the referenced vertices of adjacent
            boxes; block keys (j,), edge codes (j,) and indices (j,) of own vertices that adjacent boxes may
            reference.
        """
        found, joints = self._field.surface(min_weight, within=within, wanted_threads=self._threads)
        places, triangles, levels, seen = found
        colors = np.rint(levels).astype(np.uint8) if self._color else None
        return Mesh(places * self._voxel_size, triangles, colors), seen, joints


def median_of(counts: NDArray[np.int64]) -> float:
    """Return the median of a histogram whose index is the value.

    The median of an empty histogram is 0.
    """
    passed = np.cumsum(counts)
    if not passed[-1]:
        return 0.0
    middle = (passed[-1] - 1) // 2, passed[-1] // 2
    return float(np.searchsorted(passed, middle, side="right").mean())


def _posed(
    camera: Camera, pose: Pose
) -> tuple[tuple[float, float, float, float, int, int], NDArray[np.float64]]:
    return (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height), np.asarray(
        pose, np.float64
    )
