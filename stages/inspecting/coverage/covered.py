"""Result of the coverage analysis."""

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
    """Surface with coverage per probe; per-vertex values are computed on request.

    Attributes
    ----------
    surface, probes : the mesh, and the vertices that represent their neighbourhoods.
    evidence, kinds : (k + 1) rows, one per probe; the last row is for vertices without a probe.
    caps : defect kind and corners (c, 3, 3) in metres of triangles that would close holes.
    """

    surface: Piecewise | OnePiece
    probes: Probes
    evidence: Evidence
    kinds: NDArray[np.int8]
    caps: tuple[tuple[str, Floats], ...]

    @property
    def vertex_count(self) -> int:
        """Number of vertices that `painted` yields."""
        return self.surface.vertex_count + 3 * self._cap_count

    @property
    def triangle_count(self) -> int:
        """Number of triangles that `painted` yields."""
        return self.surface.triangle_count + self._cap_count

    @property
    def _cap_count(self) -> int:
        return sum(len(corners) for _, corners in self.caps)

    def painted(self) -> Iterator[Painted]:
        """Yield the painted mesh in batches, then its painted hole caps."""
        return painted(self.surface, self.probes, self.kinds, self.caps)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Missing and weakly observed surface of a scan.

    Attributes
    ----------
    places : defects to capture again, the most important first.
    left_out : number of defects beyond the requested maximum.
    covered : coverage of the mesh, evaluated in batches if the mesh exceeds memory.
    limits : thresholds for weakly observed surface.
    least_area, place_size, spacing : thresholds in m², metres and metres, as given or derived.
    frames : number of frames that were used.
    skipped : frames that were skipped, with the reason.
    surface_area : m².
    spread_median, spread_95 : area-weighted median and 95 % quantile of the RMS distance between measurements
        and surface, metres.
    thin_areas : weakly observed area by kind, m².
    missing_areas : missing area by kind, m², including defects that are not listed.
    ends_area : area where the scan ends, m²: space was free, but nothing was measured beyond.
    diagnostics : warnings about mesh and frames.
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
        """Evidence from all frames, per vertex."""
        return self.covered.evidence.at(self._probes)

    @property
    def kinds(self) -> NDArray[np.int8]:
        """Defect kind per vertex as index into `THIN`, (n,); -1 if well observed."""
        return self.covered.kinds[self._probes]

    @cached_property
    def painted(self) -> Mesh:
        """Mesh coloured by defect kind, followed by caps over its holes."""
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
        """Return the metrics for JSON, with units in the key names."""
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
