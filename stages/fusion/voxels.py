"""A truncated signed distance field in blocks of voxels along the surface.

What adds up in a voxel is its distance along the surface's normal, which each pixel tells anew: measured
along the optical axis, voxels just behind a road that is seen at a grazing angle would lie metres behind it.

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
# Distance, weight, count of frames and colour, or without the colour.
_VOXEL_BYTES = {True: 12, False: 7}

# How many frames saw each vertex.
Seen = NDArray[np.float32]
# Places of blocks in Z-order.
Keys = NDArray[np.uint64]
# The first block of a box along each axis, and the one after its last.
Box = tuple[tuple[int, int, int], tuple[int, int, int]]


def block_bytes(*, color: bool) -> int:
    """Return the memory of one block of voxels."""
    return BLOCK**3 * _VOXEL_BYTES[color]


class OutgrownError(StageError):
    """The volume would take more memory than it may."""


def outgrown(allowed_bytes: int, voxel_size: float) -> OutgrownError:
    """Return the error of a volume that may not grow further."""
    return OutgrownError(
        MACHINE_OUT_OF_MEMORY,
        "the volume outgrows its memory of {allowed_bytes:.0f} MB at voxels of {voxel_size:g} m.",
        remedy="Give a larger voxel_size, a smaller max_depth or more memory.",
        allowed_bytes=allowed_bytes / 1000000.0,
        voxel_size=voxel_size,
    )


@dataclass(frozen=True)
class Weighing:
    """How exact depth z is: its deviation is noise × (1 − growth + growth (z / depth)²).

    It weighs one over the square of that, and counts less where it lies farther behind the surface than its
    noise reaches: there others may see the other side of something thin.

    Attributes
    ----------
    noise : standard deviation, metres; above 0.
    depth : metres, where it is that; what is measured there weighs 1.
    growth : from 0, where all depth is equally exact, to 1, where its noise grows with its square.
    """

    noise: float
    depth: float = 1.0
    growth: float = 0.0

    def deviations(self) -> tuple[float, float, float]:
        """Return the deviation of what weighs 1, that at depth 0, and what is added for each square metre."""
        constant, quadratic = 1 - self.growth, self.growth / self.depth**2
        return self.noise, self.noise * constant, self.noise * quadratic


class Field(Protocol):
    """What frames are fused in."""

    @property
    def bytes(self) -> int:
        """Return the memory the field takes."""

    def prepared(self, view: PosedDepth, wanted: NDArray[np.bool_], pose: Pose) -> Any:
        """Return what of a frame is integrated: may run in any thread, before frames that come first are."""

    def integrate(self, view: PosedDepth, parts: Any, pose: Pose, color: ColorImage | None) -> None:
        """Add a frame, as it was prepared."""

    def typical_frames(self) -> float:
        """Return how many frames saw the median voxel near the surface."""

    def mesh(self, min_weight: int) -> tuple[Mesh, Seen | None]:
        """Return the surface through voxels that so many frames have seen, in the field's axes.

        With it, how many frames saw each vertex (n,), where that is known.
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
    """Return sorted keys of the blocks that a frame touches.

    Parameters
    ----------
    wanted : (h, w), at which pixels the surface has to be in the field; what others show tells that nothing
        is before it.
    pose : (4, 4), camera to the field's axes.
    within : no others than the blocks of a box.

    Raises
    ------
    StageError
        If it is too far from the field's origin.
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
                "a frame shows places more than {reach:.3g} km from the other cameras, "
                "farther than voxels of {voxel_size:g} m are counted."
            ),
            remedy="Check the poses, or give a larger voxel_size.",
            reach=reach / 1000,
            voxel_size=voxel_size,
        ) from error


class Volume:
    """The field; it grows by the blocks that frames touch.

    Parameters
    ----------
    voxel_size, truncation : metres; truncation along the surface's normal.
    weighing : of what is measured.
    color : whether voxels have a colour.
    max_bytes : the field may not grow past this.
    threads : to compute with.
    within : no others than the blocks of a box; None for all.
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
        """Return the memory the field takes."""
        return self._field.bytes

    def prepared(self, view: PosedDepth, wanted: NDArray[np.bool_], pose: Pose) -> Keys:
        """Return the blocks that a frame touches; see `touched_blocks`."""
        return touched_blocks(
            view,
            wanted,
            pose,
            voxel_size=self._voxel_size,
            truncation=self._truncation,
            within=self._within,
        )

    def integrate(self, view: PosedDepth, parts: Keys, pose: Pose, color: ColorImage | None) -> None:
        """Add one frame to the blocks it touches.

        Parameters
        ----------
        pose : (4, 4), camera to the field's axes; places are kept in float32, so its origin must be near.
        color : (h, w, 3) uint8 of the depth map's size; required when voxels have a colour.

        Raises
        ------
        StageError
            If the field would outgrow its memory.
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
        """Return how many frames saw the median voxel near the surface."""
        return median_of(self.frame_counts(None))

    def frame_counts(self, within: Box | None) -> NDArray[np.int64]:
        """Return of how many voxels near the surface each number (256,) of frames is, in a box of blocks."""
        return self._field.frame_counts(within=within).astype(np.int64)

    def mesh(self, min_weight: int) -> tuple[Mesh, Seen | None]:
        """Return the surface through voxels seen by at least `min_weight` frames, blocks in Z-order.

        With it, how many frames saw each vertex (n,): the mean of both voxels beside it, which count to 255.
        """
        mesh, seen, _ = self.surface(min_weight, None)
        return mesh, seen

    def surface(self, min_weight: int, within: Box | None) -> tuple[Mesh, Seen, list[Keys]]:
        """Return the surface in a box of blocks, and how it is joined to that of others.

        Returns
        -------
        The mesh, whose triangles name vertices of others by numbers from that of its own upward; how many
        frames saw each vertex (n,); and of the others' vertices the blocks (k,) and the codes of their edges
        (k,), and of those that others may name blocks, codes and numbers (j,).
        """
        found, joints = self._field.surface(min_weight, within=within, wanted_threads=self._threads)
        places, triangles, levels, seen = found
        colors = np.rint(levels).astype(np.uint8) if self._color else None
        return Mesh(places * self._voxel_size, triangles, colors), seen, joints


def median_of(counts: NDArray[np.int64]) -> float:
    """Return the median of numbers of which it is known how often each is there; 0 of none."""
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
