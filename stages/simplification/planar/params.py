"""Parameters of near-planar patches, and of method `planar` alone."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.params import check, param
from scanloom.stages.simplification.shared_params import HOW_FAR, require_finite

# At 60 levels a room's result looks like its scan; without a bound its stains and shadows are gone.
MAX_COLOR = 60.0


@dataclass(frozen=True, kw_only=True)
class PlanarParams:
    """Parameters of method `planar`."""

    patch_angle: float = param(
        40.0,
        "Largest angle between the normal of a triangle and that of the patch it joins; the paper's ε of "
        "fidelity is 1 − cos of it.",
        unit="degrees",
        low=0,
        high=80,
        low_open=True,
    )
    crease_angle: float = param(
        40.0,
        "Largest angle between the normals of a triangle and of the neighbour it is reached from; the "
        "paper's ε of detail is 1 − cos of it.",
        unit="degrees",
        low=0,
        high=90,
        low_open=True,
    )
    # The paper has none.
    noise_angle: float = param(
        75.0,
        "As patch_angle, for triangles left over in patches so small that they count as noise: they join any "
        "neighbour whose bounds on shape and colour hold them. 0 for none, as in the paper.",
        unit="degrees",
        low=0,
        high=80,
    )

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, kw_only=True)
class PatchParams(PlanarParams):
    """Parameters of `planar_patches`."""

    max_shape: float | None = param(
        None,
        "Largest distance between a mesh and what simplify makes of its patches; a patch is at most 0.8 of "
        "that thick. Default: 0.5 % of the bounding box's diagonal.",
        unit="m",
        low=0,
        low_open=True,
        group=HOW_FAR,
        common=True,
    )
    max_color: float | None = param(
        None,
        "Largest difference between the colours of a point and of its counterpart on the other surface, "
        "Euclidean over the channels; the colours of a patch are within 0.4 of that of a linear function. "
        f"Default for coloured meshes: {MAX_COLOR:g}; 1000 is no bound in effect.",
        unit="8-bit levels",
        low=0,
        group=HOW_FAR,
    )
    threads: int | None = param(
        None,
        "Parts of the mesh worked on at the same time, with the same result; one a core if not given.",
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        require_finite(self, "max_shape", "max_color")
