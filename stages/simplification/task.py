"""Arguments of a simplification method."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.surface.mesh import Mesh

P = TypeVar("P")


@dataclass(frozen=True, kw_only=True, eq=False)
class Task(Generic[P]):
    """Arguments for one call of a simplification method.

    Attributes
    ----------
    mesh : validated input mesh.
    params : parameters that only this method has; None without any.
    triangles : stop when at most this many triangles are left; None without a target.
    max_shape, max_color, attribute_scale, fit : see SharedParams.
    lock : (n,) bool, vertices to keep unchanged.
    importance : (n,) float64 above 0, factor on the squared error; (0,) for 1 everywhere.
    threads : 0 for one per core.
    record : record all collapses.
    keep_on_interrupt : on Ctrl-C, or if `progress` returns False, return the mesh simplified so far.
    progress : called about ten times per second; an exception stops the simplification.
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
    keep_on_interrupt: bool = False
    progress: Progress = ignore_progress

    def make_kernel_options(self, region_triangles: int) -> _kernels.RunSettings:
        """Build the options of a collapse kernel.

        Parameters
        ----------
        region_triangles : triangles per region of the collapse engine.
        """
        return _kernels.RunSettings(
            target_triangles=self.triangles or 0,
            threads=self.threads,
            region_triangles=region_triangles,
            record=self.record,
            partial=self.keep_on_interrupt,
        )
