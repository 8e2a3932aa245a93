"""A hierarchy of levels, and the meshes one takes out of it."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.lod.front import Cut, Front, Region
from scanloom.stages.lod.levels import Levels
from scanloom.stages.lod.view import View


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(Levels):
    """The levels of a mesh, and what to do with them."""

    def front(self) -> Front:
        """Return the root alone, no vertex split: from there it is refined and coarsened."""
        return Front(self)

    def cut(
        self,
        view: View | None = None,
        *,
        triangles: int | None = None,
        error_px: float | None = None,
        max_shape: float | None = None,
        region: Region | None = None,
    ) -> Cut:
        """Return the mesh for a view, a number of triangles or an error; see `Front.refine`."""
        front = self.front()
        front.refine(view, triangles=triangles, error_px=error_px, max_shape=max_shape, region=region)
        return front.cut()
