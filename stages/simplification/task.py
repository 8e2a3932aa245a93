"""What a method of `simplify` is given, whichever it is."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.progress import Progress, silent
from scanloom.stages.surface.mesh import Mesh

P = TypeVar("P")


@dataclass(frozen=True, kw_only=True, eq=False)
class Task(Generic[P]):
    """One call of a method.

    Attributes
    ----------
    mesh : what is to be made light; checked, as it was given.
    params : parameters that no other method has; None without any.
    triangles : stop when at most this many are left; None if no number is wanted.
    max_shape, max_color, attribute_scale, fit : see SharedParams.
    lock : (n,) bool, vertices that stay.
    importance : (n,) float64 above 0, factor of the squared error; (0,) for 1 everywhere.
    threads : 0 for one a core.
    record : keep all collapses.
    partial : Ctrl-C, or a `progress` that returns False, gives out what there is.
    progress : called about ten times a second; raising from it stops the work.
    """

    mesh: Mesh
    params: P
    triangles: int | None
    lock: NDArray[np.bool_]
    importance: NDArray[np.float64]
    max_shape: float | None
    max_color: float | None
    attribute_scale: float | None
    fit: bool
    threads: int = 0
    record: bool = False
    partial: bool = False
    progress: Progress = silent

    def running(self, region_triangles: int) -> _kernels.Running:
        """Return how a kernel that collapses edges runs, on regions of so many triangles."""
        return _kernels.Running(
            target_triangles=self.triangles or 0,
            threads=self.threads,
            region_triangles=region_triangles,
            record=self.record,
            partial=self.partial,
        )
