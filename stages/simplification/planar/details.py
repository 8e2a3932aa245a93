"""Result details of method `planar`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.simplification.planar.patches import Patches
from scanloom.stages.simplification.result import Details


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanarDetails(Details):
    """Patches of method `planar`, and their bounds.

    `refused` of the result counts input edges between two patches, by the first rule that keeps the patches
    apart: "fidelity" is the angle to the patch, "detail" the angle to the neighbour, "shape" the distance.
    "other" is a colour bound, a locked vertex, or a triangle that another patch had taken first.

    Attributes
    ----------
    shape_bound, color_bound : (q,) float64, metres and levels, bounds of each triangle's patch. Every point
        of the patch, in the input and in the result, has a counterpart in the other within both bounds; it
        need not be the nearest point. 0 where nothing changed. `color_bound` is None without colours.
    shape_bound_m, color_bound_levels : maximum over all triangles.
    max_shape_m, max_color_levels : applied bounds; `max_color_levels` is None without one.
    patch_shape_m : bound within which the patches grew: `max_shape_m`, or a tighter one that leaves no more
        triangles. `scanloom.planar_patches` reproduces the patches with this value as `max_shape`.
    kept_patches : number of patches that kept all their triangles.
    iterations : number of triangulation passes; later passes restore vertices that patches need.
    patches : patches of the input.
    triangle_patch : (q,) int32, patch of each triangle of the result.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

    headline: ClassVar[str] = (
        "{triangles:,} triangles from {patches:,} patches, no more than {shape_bound_m:at_most} m and "
        "{color_bound_levels:at_most} levels off"
    )
    arrays: ClassVar[tuple[str, ...]] = ("shape_bound", "color_bound", "patches", "triangle_patch")

    shape_bound: NDArray[np.float64]
    color_bound: NDArray[np.float64] | None
    shape_bound_m: float
    color_bound_levels: float | None
    max_shape_m: float
    patch_shape_m: float
    max_color_levels: float | None
    kept_patches: int
    iterations: int
    patches: Patches
    triangle_patch: NDArray[np.int32]

    def to_dict(self) -> dict[str, Any]:
        """Return statistics for JSON, including the largest patches."""
        return super().to_dict() | self.patches.to_dict()
