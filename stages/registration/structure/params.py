"""Parameters of structure from motion."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class StructureParams:
    """Camera poses and intrinsics of photos without poses (structure from motion)."""

    max_megapixels: float = param(
        2.0,
        "Downscale larger photos to this before features are detected. More finds finer features, and takes "
        "longer.",
        unit="Mpx",
        low=0.05,
        high=100,
    )

    max_frames: int = param(
        120,
        "Maximum number of frames that are taken from a video, evenly spaced by the motion of the image.",
        low=3,
        high=2000,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
