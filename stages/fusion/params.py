"""How frames are fused."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, param

Point = tuple[float, float, float]
Corners = tuple[float, float, float, float, float, float]

_CROP = "What is fused"


@dataclass(frozen=True, kw_only=True)
class FuseParams:
    """Parameters of `fuse`."""

    voxel_size: float | None = param(
        None,
        "Edge of a voxel. Derived: twice the spacing of depth pixels at median depth, twice the measured "
        "depth noise there, or what keeps the mesh near 2 million triangles, whichever is largest. Of a "
        "frame alone the pixels are joined; some are left out so that vertices are half of this apart at "
        "median depth.",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    voxel_factor: float = param(
        1.0,
        "The derived voxel size is this many times as large: 2 for a quarter of the triangles, 0.7 for twice "
        "as many. Without effect where voxel_size is given.",
        low=0.1,
        high=100,
    )
    truncation: float | None = param(
        None,
        "Distance from the surface, along its normal, at which the field is cut off. Derived: three times "
        "the measured noise of far depth, but 3 to 5 voxels (more if the voxels are finer than the noise). "
        "A frame alone has no field.",
        unit="m",
        low=0,
        low_open=True,
    )
    min_depth: float = param(0.0, "Nearer depth is ignored.", unit="m", low=0)
    max_depth: float | None = param(
        None,
        "Farther depth is ignored. Derived: where the measured noise reaches a third of the truncation.",
        unit="m",
        low=0,
        low_open=True,
        common=True,
    )
    max_jump: float = param(
        0.05,
        "Where depth changes by more than this share of itself from one pixel to the next, both are dropped: "
        "sensors put false depth beside such discontinuities.",
        low=0,
        low_open=True,
    )
    max_angle: float | None = param(
        None,
        "Pixels that see the surface at a larger angle to its normal are dropped. Derived: 87; 89 for a "
        "frame alone.",
        unit="degrees",
        low=0,
        high=89,
    )
    min_weight: int | None = param(
        None,
        "How many frames must have seen a voxel for the surface to pass through it. Derived: half of what "
        "the median voxel was seen, from 1 to 3; of a masked thing a quarter of the frames at most.",
        unit="frames",
        low=1,
    )
    box: tuple[float, float, float, float, float, float] | None = param(
        None,
        "Only what is inside this box is fused: the lowest corner, then the highest, in the scan's world, "
        "whose extent `scanloom inspect` tells.",
        unit="m",
        group=_CROP,
        common=True,
    )
    radius: float | None = param(
        None, "Only what is this near to `center` is fused.", unit="m", low=0, low_open=True, group=_CROP
    )
    center: tuple[float, float, float] | None = param(
        None,
        "Where the thing is, for `radius` and `remove_plane`. Derived: where the cameras' optical axes meet, "
        "or else the middle of what is in the middle of the images.",
        unit="m",
        group=_CROP,
    )
    remove_plane: bool = param(
        False,
        "Leave out the table or floor that the thing stands on, and what is below it.",
        group=_CROP,
        common=True,
    )
    plane_margin: float | None = param(
        None,
        "How far above that plane what is fused begins. Derived: three times the spread of depth about the "
        "plane, but at least one and a half voxels.",
        unit="m",
        low=0,
        group=_CROP,
    )
    upsample: str = param(
        "auto",
        "Small depth maps are made larger before they are fused, by the photo where it tells near from far: "
        "guided does it to all, off to none; auto to that of a frame alone whose photo is so much larger. "
        "Voxels of several frames stay as large as they were, and have to be made smaller for a gain.",
        choices=("auto", "off", "guided"),
    )
    upsample_factor: int = param(2, "How many times as wide and as high they become.", low=2, high=8)
    color: bool = param(True, "Give the mesh vertex colours, when the frames have colour.")
    max_bad_share: float = param(
        0.2, "Share of frames that may be unusable (damaged, without pose or depth).", low=0, high=1
    )
    memory: float = param(
        4000.0,
        "The volume may not outgrow this: space is cut in bricks that do not.",
        unit="MB",
        low=1,
        invalidates=False,
    )
    brick_size: float | None = param(
        None,
        "Space is cut in cubes of about this size, of which as many are fused at a time as fit into "
        "`memory`, and each is kept. The mesh is the same. Derived: 4, where the field does not fit; else "
        "space is one piece.",
        unit="m",
        low=0,
        low_open=True,
        high=4,
        invalidates=False,
    )
    backend: str = param(
        "auto",
        "Whose voxels: own, or those of Open3D, which are slower and larger, but work on a CUDA device. auto "
        "takes Open3D's there, and its own elsewhere.",
        choices=("auto", "own", "open3d"),
    )
    device: str = param(
        "cpu",
        "Where to fuse: auto takes a CUDA device when Open3D finds one, cuda insists on it.",
        choices=("cpu", "cuda", "auto"),
    )

    def __post_init__(self) -> None:
        check(self)
        if self.box is not None and not all(a < b for a, b in zip(self.box[:3], self.box[3:], strict=True)):
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {box} m; its first three numbers must be the lowest corner, its last three the highest.",
                Where(parameter="box"),
                box=" ".join(f"{x:g}" for x in self.box),
            )
