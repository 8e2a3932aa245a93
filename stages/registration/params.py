"""How poses are found."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check, param

_HOW = "How"


@dataclass(frozen=True, kw_only=True)
class RegisterParams:
    """How poses are found for frames that have none."""

    enabled: bool | None = param(
        None,
        "Find poses: by default only where the scan has none; true finds them anew, false refuses such "
        "a scan.",
    )
    max_depth: float | None = param(
        None,
        "Depth beyond this is not used to find poses. Default: 2.5 times the median depth of the scan.",
        group=_HOW,
        unit="m",
        low=0,
        low_open=True,
    )
    refine: bool = param(
        False,
        "Begin from the poses the scan has, and make them better; its world stays where it is. Where what is "
        "found is not better on points it was not found by, the poses stay.",
        common=True,
    )
    piece: int = param(
        1,
        "Which piece of a scan that falls apart is used: 1 for the one of the most frames, 2 for the next.",
        low=1,
    )
    subject: str = param(
        "auto",
        "What is registered, and fused: the `scene`, or the `object` alone that moves before a camera that "
        "stands still, as on a turntable; all else is masked out. `auto` takes the object if there is one.",
        choices=("auto", "scene", "object"),
        common=True,
    )
    focal: bool = param(
        True,
        "Where nobody states the camera, estimate its focal length from points that several frames show.",
        group=_HOW,
    )
    loops: bool = param(True, "Look for places that were seen before, and close the loop.", group=_HOW)

    def __post_init__(self) -> None:
        check(self)
