"""Parameters of fusion."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param

Point = tuple[float, float, float]
Corners = tuple[float, float, float, float, float, float]

_CROP = "Crop"


@dataclass(frozen=True, kw_only=True)
class FuseParams:
    """Parameters of `fuse`."""

    voxel_size: float | None = param(
        None,
        "Edge of a voxel. Derived: the largest of twice the pixel spacing at median depth, twice the depth "
        "noise there, and the size that keeps the mesh near 2 million triangles. A single frame is meshed "
        "from its pixels, with vertices half of this apart at median depth.",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    voxel_factor: float = param(
        1.0,
        "Factor of the derived voxel size: 2 gives a quarter of the triangles, 0.7 twice as many. No effect "
        "if voxel_size is given.",
        low=0.1,
        high=100,
    )
    truncation: float | None = param(
        None,
        "Truncation distance of the TSDF along the surface normal. Derived: three times the noise of far "
        "depth, within 3 to 5 voxels (more if the voxels are finer than the noise). No effect on a single "
        "frame.",
        unit="m",
        low=0,
        low_open=True,
    )
    min_depth: float = param(0.0, "Minimum depth; nearer depth is ignored.", unit="m", low=0)
    max_depth: float | None = param(
        None,
        "Maximum depth; farther depth is ignored. Derived: where noise reaches a third of the truncation.",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    max_jump: float = param(
        0.05,
        "Maximum relative change of depth between neighbouring pixels. Both pixels are dropped beyond it, "
        "because sensors report false depth next to such jumps.",
        low=0,
        low_open=True,
    )
    max_angle: float | None = param(
        None,
        "Maximum angle between the line of sight and the surface normal; more oblique pixels are dropped. "
        "Derived: 87; 89 for a single frame.",
        unit="degrees",
        low=0,
        high=89,
    )
    min_weight: int | None = param(
        None,
        "Minimum number of frames that must have observed a voxel of the surface. Derived: half of the "
        "median observation count, within 1 to 3; for a masked object at most a quarter of the frames.",
        unit="frames",
        low=1,
    )
    box: tuple[float, float, float, float, float, float] | None = param(
        None,
        "Fuse only points inside this box: lowest corner, then highest corner, in world coordinates. "
        "`scanloom inspect` shows the extent of the scan.",
        unit="m",
        group=_CROP,
        common=True,
    )
    radius: float | None = param(
        None,
        "Fuse only points within this distance of `center`.",
        unit="m",
        low=0,
        low_open=True,
        group=_CROP,
    )
    center: tuple[float, float, float] | None = param(
        None,
        "Position of the object, for `radius` and `remove_plane`. Derived: the intersection of the optical "
        "axes, else the median of the points in the image centres.",
        unit="m",
        group=_CROP,
    )
    remove_plane: bool = param(
        False,
        "Remove the table or floor under the object, and everything below it.",
        group=_CROP,
        common=True,
    )
    plane_margin: float | None = param(
        None,
        "Minimum distance above that plane. Derived: three standard deviations of the depth around the "
        "plane, but at least 1.5 voxels.",
        unit="m",
        low=0,
        group=_CROP,
    )
    upsample: str = param(
        "auto",
        "Upsample low-resolution depth before fusion, guided by the photo: auto only for single-frame scans "
        "with a photo at least upsample_factor times as wide, guided always, off never. With several frames "
        "the derived voxel size does not change; reduce it to benefit.",
        choices=("auto", "off", "guided"),
    )
    upsample_factor: int = param(2, "Factor by which upsampling increases width and height.", low=2, high=8)
    color: bool = param(True, "Give the mesh vertex colours if the frames have colour.")
    max_skipped_ratio: float = param(
        0.2, "Maximum ratio of unusable frames (damaged, or without pose or depth).", low=0, high=1
    )
    memory: float = param(
        4000.0,
        "Memory limit of the volume; larger scans are fused in bricks that fit.",
        unit="MB",
        low=1,
        invalidates=False,
    )
    brick_size: float | None = param(
        None,
        "Fuse in cubes of about this size, as many at a time as fit in `memory`, and cache each. The mesh "
        "does not depend on it. Derived: 4 if the volume does not fit in memory, else no bricks.",
        unit="m",
        low=0,
        low_open=True,
        high=4,
        invalidates=False,
    )
    backend: str = param(
        "auto",
        "TSDF implementation: own, or open3d, which is slower and needs more memory, but supports CUDA "
        "devices. auto uses open3d on a CUDA device, and own elsewhere.",
        choices=("auto", "own", "open3d"),
    )
    device: str = param(
        "cpu",
        "Device for fusion: auto uses a CUDA device if Open3D finds one, cuda requires it.",
        choices=("cpu", "cuda", "auto"),
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.box is not None and not all(a < b for a, b in zip(self.box[:3], self.box[3:], strict=True)):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {box} m; the first three numbers must be the lowest corner, the last three the highest.",
                DiagnosticLocation(parameter="box"),
                box=" ".join(f"{x:g}" for x in self.box),
            )
