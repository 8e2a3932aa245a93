"""Parameters of near-planar patches and of method `planar`."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check_parameters, param
from scanloom.stages.simplification.shared_params import TARGET_GROUP, require_finite

# 8-bit levels. At 60 levels a simplified room looks like its scan; without a bound, stains and shadows
# disappear.
MAX_COLOR = 60.0


@dataclass(frozen=True, kw_only=True)
class PlanarParams:
    """Parameters of method `planar`."""

    patch_angle: float = param(
        40.0,
        "Maximum angle between the normals of a triangle and of the patch that it joins; the "
        "paper's ε of fidelity is 1 − cos of it.",
        unit="degrees",
        low=0,
        high=80,
        low_open=True,
    )
    crease_angle: float = param(
        40.0,
        "Maximum angle between the normals of a triangle and of the neighbour from which a "
        "patch grows to it; the paper's ε of detail is 1 − cos of it.",
        unit="degrees",
        low=0,
        high=90,
        low_open=True,
    )
    # Not in the paper.
    noise_angle: float = param(
        75.0,
        "As patch_angle, for triangles of patches so small that they count as noise: they "
        "join any neighbouring patch whose bounds on shape and colour allow it. 0 disables "
        "this, as in the paper.",
        unit="degrees",
        low=0,
        high=80,
    )

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class PatchParams(PlanarParams):
    """Parameters of `planar_patches`."""

    max_shape: float | None = param(
        None,
        "Maximum distance between a mesh and its simplified patches; the thickness of a "
        "patch is at most 0.8 of it. Default: 0.5 % of the bounding box's diagonal.",
        unit="m",
        low=0,
        low_open=True,
        group=TARGET_GROUP,
        common=True,
    )
    max_color: float | None = param(
        None,
        "Maximum colour difference, Euclidean over the channels, between a point and its counterpart on the "
        "other surface; the colours of a patch are within 0.4 of it of a linear function. Default for "
        f"coloured meshes: {MAX_COLOR:g}; 1000 is effectively no bound.",
        unit="8-bit levels",
        low=0,
        group=TARGET_GROUP,
    )
    threads: int | None = param(
        None,
        "Number of threads; the result does not depend on it. Default: one per core.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite(self, "max_shape", "max_color")
