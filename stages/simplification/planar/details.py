"""What method `planar` has to tell: the patches, and how far they are off."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.printing import by_fields, table
from scanloom.stages.simplification.planar.patches import Patches
from scanloom.stages.simplification.result import Details


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanarDetails(Details):
    """The patches, and how far they are off.

    `refused` of the result counts edges of the input between two patches, by the first of the rules that
    keeps the patches on both sides apart: "fidelity" and "detail" are the angles with the patch and with the
    neighbour, "shape" the distance, "other" colours, a locked vertex, or that another patch was there first.

    Attributes
    ----------
    shape_bound, color_bound : (q,) float64, metres and levels, how far each triangle's patch is off at most,
        both ways: every point of the patch, in the input and in the result, has a counterpart in the other
        within `shape_bound`, and the colours of the two differ by `color_bound` at most. That need not be the
        nearest point; 0 where nothing changed. `color_bound` is None for a mesh without colours.
    shape_bound_m, color_bound_levels : the greatest of all.
    max_shape_m, max_color_levels : what was used; None for no bound.
    patch_shape_m : the bound that the patches grew within: `max_shape_m`, or a tighter one that leaves no
        more triangles. With that as its `max_shape`, `scanloom.planar_patches` finds them.
    kept_patches : patches that have all their triangles still.
    iterations : how often patches were triangulated, as vertices were put back.
    patches : those of the input.
    triangle_patch : (q,) int32, the patch of each triangle of the result.
    """

    __repr__ = by_fields
    _repr_html_ = table

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

    def figures(self) -> dict[str, Any]:
        """Return everything but the arrays, with the number of patches and the largest ones."""
        return super().figures() | self.patches.figures()
