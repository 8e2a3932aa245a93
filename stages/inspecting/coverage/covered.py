"""What is missing in a scan, as it was found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.inspecting.coverage.evidence import Evidence
from scanloom.stages.inspecting.coverage.painted import Painted, painted
from scanloom.stages.inspecting.coverage.place import Place
from scanloom.stages.inspecting.coverage.probes import Probes
from scanloom.stages.inspecting.coverage.thin import Limits
from scanloom.stages.inspecting.coverage.views import Floats
from scanloom.stages.printing import by_figures, table
from scanloom.stages.scans.model.scan import SkippedFrame
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.piecewise import OnePiece, Piecewise


@dataclass(frozen=True, eq=False)
class Covered:
    """A surface, and what is known of it; what is told of each vertex is made of that when it is asked for.

    Attributes
    ----------
    surface, probes : the mesh, and vertices that stand for those around them.
    evidence, kinds : (k + 1) of each probe; the last row of what has none.
    caps : kind and corners (c, 3, 3), metres, of what would close holes.
    """

    surface: Piecewise | OnePiece
    probes: Probes
    evidence: Evidence
    kinds: NDArray[np.int8]
    caps: tuple[tuple[str, Floats], ...]

    @property
    def vertex_count(self) -> int:
        """Return how many vertices `painted` yields."""
        return self.surface.vertex_count + 3 * self._cap_count

    @property
    def triangle_count(self) -> int:
        """Return how many triangles `painted` yields."""
        return self.surface.triangle_count + self._cap_count

    @property
    def _cap_count(self) -> int:
        return sum(len(corners) for _, corners in self.caps)

    def painted(self) -> Iterator[Painted]:
        """Yield the mesh in colours, piece by piece, and behind it what would close its holes."""
        return painted(self.surface, self.probes, self.kinds, self.caps)


@dataclass(frozen=True, eq=False)
class Coverage:
    """What is missing in a scan.

    Attributes
    ----------
    places : where to go again, the most important first.
    left_out : how many places are not told, beyond as many as were asked for.
    covered : what is known of the mesh; piece by piece, where it has no room in memory.
    limits : what counted as thin.
    least_area, place_size, spacing : m² and metres, as given or derived.
    frames : how many were looked at.
    skipped : those that were not, and why.
    surface_area : m².
    spread_median, spread_95 : metres; that of half of what was measured of the surface, and of 95 % of it, is
        at most as large.
    thin_areas : m² of the surface, by kind.
    missing_areas : m² of what is not there at all, by kind; also of places that are not told.
    ends_area : m² where the scan ends: nobody measured anything beyond, and it is open to the other side.
    diagnostics : what is odd about mesh and frames.
    """

    places: tuple[Place, ...]
    left_out: int
    covered: Covered
    limits: Limits
    least_area: float
    place_size: float
    spacing: float
    frames: int
    skipped: tuple[SkippedFrame, ...]
    surface_area: float
    spread_median: float
    spread_95: float
    thin_areas: dict[str, float]
    missing_areas: dict[str, float]
    ends_area: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def evidence(self) -> Evidence:
        """Return what frames have measured of each vertex."""
        return self.covered.evidence.at(self._probes)

    @property
    def kinds(self) -> NDArray[np.int8]:
        """Return the index of each vertex in `coverage.kinds.THIN`, (n,); -1 for well seen."""
        return self.covered.kinds[self._probes]

    @cached_property
    def painted(self) -> Mesh:
        """Return the mesh in colours of that, and behind its triangles what would close its holes."""
        vertices, colors, triangles = (
            np.concatenate([getattr(part, name) for part in self.covered.painted()])
            for name in ("vertices", "colors", "triangles")
        )
        return Mesh(vertices, triangles.astype(np.int32), colors)

    @cached_property
    def _probes(self) -> NDArray[np.int64]:
        every = np.concatenate([part.probes for part in self.covered.painted()])
        return every[: self.covered.surface.vertex_count]

    def figures(self) -> dict[str, Any]:
        """Return what there is to say, for JSON, units in the names."""
        return {
            "frames_used": self.frames,
            "frames_skipped": [one.figures() for one in self.skipped],
            "surface_m2": self.surface_area,
            "spread_median_m": self.spread_median,
            "spread_95_m": self.spread_95,
            "thin_m2": self.thin_areas,
            "missing_m2": self.missing_areas,
            "scan_ends_m2": self.ends_area,
            "few_frames": self.limits.frames,
            "oblique_deg": float(np.degrees(np.arccos(self.limits.cosine))),
            "far_m": self.limits.distance,
            "spread_m": self.limits.spread,
            "least_area_m2": self.least_area,
            "place_size_m": self.place_size,
            "spacing_m": self.spacing,
            "places_left_out": self.left_out,
            "places": [place.figures() for place in self.places],
        }
