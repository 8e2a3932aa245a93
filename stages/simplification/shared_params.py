"""Parameters of `simplify` that several or all methods share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param

# Headings of the help.
TARGET_GROUP = "Target: a triangle count, bounds or both"
METHOD_GROUP = "Method"


@dataclass(frozen=True, kw_only=True)
class SharedParams:
    """Parameters of `simplify` that several or all methods share."""

    triangles: int | None = param(
        None,
        "Stop when at most this many triangles are left.",
        group=TARGET_GROUP,
        low=1,
        common=True,
    )
    ratio: float | None = param(
        None,
        "Stop when at most this fraction of the input's triangles is left.",
        group=TARGET_GROUP,
        low=0,
        high=1,
        low_open=True,
        common=True,
    )
    max_shape: float | None = param(
        None,
        "certified: maximum distance of any point of either surface from the other surface. "
        "Default: 0.5 % of the bounding box's diagonal, because a colour bound alone does "
        "not preserve the shape. jia01: maximum shape change, accumulated over the collapses "
        "around an edge. Default: 0.1 of a given resolution, else 3.6 mean edge lengths, but at "
        "most 0.5 % of the diagonal. "
        "planar: maximum distance between a mesh and its simplified patches; the thickness "
        "of a patch is at most 0.8 of it. Default: 0.5 % of the bounding box's diagonal.",
        unit="m",
        group=TARGET_GROUP,
        low=0,
        low_open=True,
        common=True,
    )
    max_color: float | None = param(
        None,
        "certified: maximum colour difference, Euclidean over the channels, between any "
        "point of either surface and any nearest point of the other. Default: no bound. "
        "jia01: maximum contrast in the neighbourhood of a collapse, accumulated over the "
        "collapses around an edge; it far exceeds the resulting colour error. Default: 700. "
        "planar: maximum colour difference, Euclidean over the channels, between a point and "
        "its counterpart on the other surface; the colours of a patch are within 0.4 of it "
        "of a linear function. Default for coloured meshes: 60; 1000 is effectively no bound.",
        unit="8-bit levels",
        group=TARGET_GROUP,
        low=0,
        common=True,
    )
    noise_factor: float = param(
        2.0,
        "Without a target: maximum distance between both surfaces in standard deviations of the measured "
        "surface, for meshes that come with them and get a texture.",
        unit="standard deviations",
        group=TARGET_GROUP,
        low=0,
        low_open=True,
    )
    drop_below: float | None = param(
        None,
        "Before simplification, remove connected components and fill holes whose bounding box has a shorter "
        "diagonal than this. The result reports their number and area; no bound covers them.",
        unit="m",
        group=TARGET_GROUP,
        low=0,
        low_open=True,
    )
    attribute_scale: float | None = param(
        None,
        "Length that weighs as much as one level of colour, for quadric, certified, seams "
        "and jia01. Default: derived from the mesh and the triangle count; for jia01 "
        "max_shape / max_color.",
        unit="m per level",
        group=METHOD_GROUP,
        low=0,
    )
    fit: bool = param(
        True,
        "Fit vertices (quadric: colours, too) to the input by least squares at the end; "
        "borders stay. For quadric and seams.",
        group=METHOD_GROUP,
    )
    keep_uv: bool = param(
        False,
        "Keep the model's own texture coordinates and images instead of baking new ones; "
        "texture seams then restrict the simplification.",
        group=METHOD_GROUP,
        common=True,
    )
    bake: bool | None = param(
        None,
        "Bake new images for the simplified mesh, in the format of the input's images and "
        "with at most their number of texels; vertex colours are baked, too. Off: textures "
        "are discarded. Default: on if the input has images, unless keep_uv or a method that "
        "preserves them is given.",
        group=METHOD_GROUP,
        common=True,
    )
    threads: int | None = param(
        None,
        "Number of threads; the result does not depend on it. Default: one per core.",
        group=METHOD_GROUP,
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        require_finite(self, "max_shape", "max_color", "noise_factor", "attribute_scale")
        if self.keep_uv and self.bake:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "and bake are both given",
                DiagnosticLocation(parameter="keep_uv"),
                remedy="give one of them.",
            )
        if self.triangles is not None and self.ratio is not None:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "and ratio are both given",
                DiagnosticLocation(parameter="triangles"),
                remedy="give one of them.",
            )

    def compute_target_count(self, triangles: int) -> int | None:
        """Return the target triangle count; None without a target.

        Parameters
        ----------
        triangles : triangle count of the input, for `ratio`.
        """
        return math.floor(self.ratio * triangles) if self.ratio is not None else self.triangles


def require_finite(params: Any, *names: str) -> None:
    """Raise UsageError for the first of these parameters that is infinite."""
    for name in names:
        if getattr(params, name) == math.inf:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is infinite",
                DiagnosticLocation(parameter=name),
                remedy="leave it out, and give triangles or ratio instead.",
            )
