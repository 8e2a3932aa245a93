"""Level-of-detail hierarchy, and extraction of meshes from it."""

from __future__ import annotations

from dataclasses import dataclass

from scanloom.stages.lod.front import Cut, Front, Region
from scanloom.stages.lod.levels import Levels
from scanloom.stages.lod.view import View


@dataclass(frozen=True, eq=False, repr=False)
class Hierarchy(Levels):
    """Levels of a mesh with methods to extract meshes."""

    def front(self) -> Front:
        """Return a new front with the unsplit root only, to be refined."""
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
        """Extract the mesh for a view, a number of triangles or an error; see `Front.refine`."""
        front = self.front()
        front.refine(view, triangles=triangles, error_px=error_px, max_shape=max_shape, region=region)
        return front.cut()
