"""What limits near-planar patches."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from stages.errors import UsageError
from stages.params import check, param

# At 60 levels a room's result looks like its scan; without a bound its stains and shadows are gone.
MAX_TEXTURE = 60.0
PATCH_ANGLE = 40.0
CREASE_ANGLE = 40.0
NOISE_ANGLE = 75.0


def patch_angle(default: float | None, group: str = "") -> Any:
    """Declare the angle of the paper's first criterion."""
    return param(
        default,
        "planar: largest angle between the normal of a triangle and that of the patch it joins; the paper's "
        f"ε of fidelity is 1 − cos of it. Default: {PATCH_ANGLE:g}.",
        unit="degrees",
        low=0,
        high=80,
        low_open=True,
        group=group,
    )


def crease_angle(default: float | None, group: str = "") -> Any:
    """Declare the angle of the paper's second criterion."""
    return param(
        default,
        "planar: largest angle between the normals of a triangle and of the neighbour it is reached from; "
        f"the paper's ε of detail is 1 − cos of it. Default: {CREASE_ANGLE:g}.",
        unit="degrees",
        low=0,
        high=90,
        low_open=True,
        group=group,
    )


def noise_angle(default: float | None, group: str = "") -> Any:
    """Declare the angle for what is left over; the paper has none."""
    return param(
        default,
        "planar: as patch_angle, for triangles left over in patches so small that they count as noise: they "
        "join any neighbour whose bounds on shape and texture hold them. 0 for none, as in the paper. "
        f"Default: {NOISE_ANGLE:g}.",
        unit="degrees",
        low=0,
        high=80,
        group=group,
    )


@dataclass(frozen=True, kw_only=True)
class PatchParams:
    """What limits near-planar patches."""

    max_shape: float | None = param(
        None,
        "Largest distance between a mesh and what simplify makes of its patches; a patch is at most 0.8 of "
        "that thick. Default: 0.5 % of the bounding box's diagonal.",
        unit="m",
        low=0,
        low_open=True,
    )
    max_texture: float | None = param(
        None,
        "Largest difference of colour, likewise, Euclidean over the channels; the colours of a patch are "
        f"within 0.4 of that of a linear function. Default for coloured meshes: {MAX_TEXTURE:g}; 1000 is no "
        "bound in effect.",
        unit="8-bit levels",
        low=0,
    )
    patch_angle: float = patch_angle(PATCH_ANGLE)
    crease_angle: float = crease_angle(CREASE_ANGLE)
    noise_angle: float = noise_angle(NOISE_ANGLE)
    threads: int | None = param(
        None,
        "Parts of the mesh worked on at the same time, with the same result; one a core if not given.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check(self)
        for name in ("max_shape", "max_texture"):
            if getattr(self, name) == math.inf:
                raise UsageError(f"{name} is infinite; leave it out.")
