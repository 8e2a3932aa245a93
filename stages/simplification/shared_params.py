"""Parameters of `simplify` that all or several methods have."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, param

# Headings of the help.
HOW_FAR = "How far: a number, bounds or both"
HOW = "How"


@dataclass(frozen=True, kw_only=True)
class SharedParams:
    """Parameters of `simplify` that all or several methods have."""

    triangles: int | None = param(
        None,
        "Stop when at most this many triangles are left.",
        group=HOW_FAR,
        low=1,
        common=True,
    )
    ratio: float | None = param(
        None,
        "Stop when at most this share of the input's triangles is left.",
        group=HOW_FAR,
        low=0,
        high=1,
        low_open=True,
        common=True,
    )
    max_shape: float | None = param(
        None,
        "certified: largest distance of any point of either surface from the other. Default: 0.5 % of the "
        "bounding box's diagonal, as colours alone do not hold a shape. jia01: largest shape change, summed "
        "over the collapses around an edge. Default: 0.1 of the resolution, but at most 0.5 % of the "
        "diagonal. planar: largest distance between a mesh and what simplify makes of its patches; a patch "
        "is at most 0.8 of that thick. Default: 0.5 % of the bounding box's diagonal.",
        unit="m",
        group=HOW_FAR,
        low=0,
        low_open=True,
        common=True,
    )
    max_color: float | None = param(
        None,
        "certified: largest difference, Euclidean over the channels, between the colour at any point of "
        "either surface and that at any nearest point of the other. Default: no bound. jia01: the strongest "
        "contrast in the neighbourhood of a collapse, summed over the collapses around an edge, which far "
        "exceeds the colour error that results. Default: 400. planar: largest difference between the colours "
        "of a point and of its counterpart on the other surface, Euclidean over the channels; the colours of "
        "a patch are within 0.4 of that of a linear function. Default for coloured meshes: 60; 1000 is no "
        "bound in effect.",
        unit="8-bit levels",
        group=HOW_FAR,
        low=0,
        common=True,
    )
    drop_below: float | None = param(
        None,
        "Before simplification, remove connected components and fill holes whose bounding box has a shorter "
        "diagonal than this. The result reports their number and area; no bound covers them.",
        unit="m",
        group=HOW_FAR,
        low=0,
        low_open=True,
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour, for quadric, certified, seams and jia01. "
        "Default: derived from the mesh and the number of triangles; for jia01 max_shape / max_color.",
        unit="m per level",
        group=HOW,
        low=0,
    )
    fit: bool = param(
        True,
        "Move vertices (quadric: colours too) to fit the input by least squares at the end; boundaries stay. "
        "For quadric and seams.",
        group=HOW,
    )
    keep_uv: bool = param(
        False,
        "Keep the model's own texture coordinates and images, rather than bake new ones: seams then hold the "
        "shape in place.",
        group=HOW,
        common=True,
    )
    bake: bool | None = param(
        None,
        "Bake new images for the simplified mesh, in the format and no more texels than those of the input; "
        "vertex colours go into an image too. Off: textures are lost. Default: where the input has images, "
        "unless keep_uv or a method that carries them is given.",
        group=HOW,
        common=True,
    )
    threads: int | None = param(
        None,
        "Parts of the mesh worked on at the same time, with the same result; one a core if not given.",
        group=HOW,
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check(self)
        require_finite(self, "max_shape", "max_color", "attribute_scale")
        if self.keep_uv and self.bake:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "and bake are both given",
                Where(parameter="keep_uv"),
                remedy="give one of them.",
            )
        if self.triangles is not None and self.ratio is not None:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "and ratio are both given",
                Where(parameter="triangles"),
                remedy="give one of them.",
            )

    def target(self, triangles: int) -> int | None:
        """Return how many of so many triangles are wanted; None if there is no such wish."""
        return math.floor(self.ratio * triangles) if self.ratio is not None else self.triangles


def require_finite(params: Any, *names: str) -> None:
    """Raise UsageError for the first of these parameters that is infinite."""
    for name in names:
        if getattr(params, name) == math.inf:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is infinite",
                Where(parameter=name),
                remedy="leave it out, and give triangles or ratio instead.",
            )
