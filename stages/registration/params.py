"""Parameters of registration."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param

_HOW = "How"


@dataclass(frozen=True, kw_only=True)
class RegisterParams:
    """Parameters of pose estimation for frames without poses."""

    enabled: bool | None = param(
        None,
        "Estimate poses. Default: if the scan has none. true replaces existing poses, false rejects a scan "
        "without poses.",
    )
    max_depth: float | None = param(
        None,
        "Ignore depth beyond this when estimating poses. Default: 2.5 times the median depth of the scan.",
        group=_HOW,
        unit="m",
        low=0,
        low_open=True,
    )
    refine: bool = param(
        False,
        "Refine the existing poses of the scan, in the same world. The existing poses are kept if the "
        "refined poses are not better on held-out points.",
        common=True,
    )
    piece: int = param(
        1,
        "Piece to use if not all frames can be connected: 1 has the most frames, 2 the second most.",
        low=1,
    )
    subject: str = param(
        "auto",
        "Subject to register and fuse: the whole `scene`, or only the `object` that moves in front of a "
        "static camera, as on a turntable, with all else masked out. `auto` selects the object if there is "
        "one.",
        choices=("auto", "scene", "object"),
        common=True,
    )
    focal: bool = param(
        True,
        "Estimate the focal length from matched points if the scan has no camera intrinsics.",
        group=_HOW,
    )
    loops: bool = param(True, "Detect places that were seen before, and close loops.", group=_HOW)

    def __post_init__(self) -> None:
        check_parameters(self)
