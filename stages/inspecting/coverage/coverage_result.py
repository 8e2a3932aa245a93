"""Result of the coverage analysis."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.inspecting.coverage.defect import CoverageDefect
from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.inspecting.coverage.measurement_evidence import Evidence
from scanloom.stages.inspecting.coverage.painted_batches import PaintedBatch, paint_coverage
from scanloom.stages.inspecting.coverage.probes import Probes
from scanloom.stages.inspecting.coverage.weak_surface import EvidenceLimits
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.scans.model.scan import SkippedFrame
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh
from scanloom.stages.surface.mesh import Mesh


@dataclass(frozen=True, eq=False)
class SurfaceCoverage:
    """Surface with coverage per probe; per-vertex values are computed on request.

    Attributes
    ----------
    surface, probes : the mesh, and the vertices that represent their neighbourhoods.
    evidence, kinds : (k + 1) rows, one per probe; the last row is for vertices without a probe.
    caps : defect kind and corners (c, 3, 3) in metres of triangles that would close holes.
    """

    surface: ChunkedMesh | SingleChunkMesh
    probes: Probes
    evidence: Evidence
    kinds: NDArray[np.int8]
    caps: tuple[tuple[str, Floats], ...]

    @property
    def vertex_count(self) -> int:
        """Number of vertices that `paint_coverage` yields."""
        return self.surface.vertex_count + 3 * self._cap_count

    @property
    def triangle_count(self) -> int:
        """Number of triangles that `paint_coverage` yields."""
        return self.surface.triangle_count + self._cap_count

    @property
    def _cap_count(self) -> int:
        return sum(len(corners) for _, corners in self.caps)

    def iterate_painted(self) -> Iterator[PaintedBatch]:
        """Yield the painted mesh in batches, then its painted hole caps."""
        return paint_coverage(self.surface, self.probes, self.kinds, self.caps)


@dataclass(frozen=True, eq=False)
class Coverage:
    """Missing and weakly observed surface of a scan.

    Attributes
    ----------
    defects : defects to capture again, the most important first.
    omitted_count : number of defects beyond the requested maximum.
    surface_coverage : coverage of the mesh, evaluated in batches if the mesh exceeds memory.
    limits : thresholds for weakly observed surface.
    min_area, max_patch_size, spacing : thresholds in m², metres and metres, as given or derived.
    frame_count : number of frames that were used.
    skipped : frames that were skipped, with the reason.
    surface_area : m².
    spread_median, spread_95 : area-weighted median and 95 % quantile of the RMS distance between measurements
        and surface, metres.
    weak_areas : weakly observed area by kind, m².
    missing_areas : missing area by kind, m², including defects that are not listed.
    scan_end_area : area where the scan ends, m²: space was free, but nothing was measured beyond.
    diagnostics : warnings about mesh and frames.
    """

    defects: tuple[CoverageDefect, ...]
    omitted_count: int
    surface_coverage: SurfaceCoverage
    limits: EvidenceLimits
    min_area: float
    max_patch_size: float
    spacing: float
    frame_count: int
    skipped: tuple[SkippedFrame, ...]
    surface_area: float
    spread_median: float
    spread_95: float
    weak_areas: dict[str, float]
    missing_areas: dict[str, float]
    scan_end_area: float
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def vertex_evidence(self) -> Evidence:
        """Evidence from all frames, per vertex."""
        return self.surface_coverage.evidence.select(self._vertex_probes)

    @property
    def vertex_kinds(self) -> NDArray[np.int8]:
        """Defect kind per vertex as index into `WEAK_KINDS`, (n,); -1 if well observed."""
        return self.surface_coverage.kinds[self._vertex_probes]

    @cached_property
    def painted_mesh(self) -> Mesh:
        """Mesh coloured by defect kind, followed by caps over its holes."""
        vertices, colors, triangles = (
            np.concatenate([getattr(part, name) for part in self.surface_coverage.iterate_painted()])
            for name in ("vertices", "colors", "triangles")
        )
        return Mesh(vertices, triangles.astype(np.int32), colors)

    @cached_property
    def _vertex_probes(self) -> NDArray[np.int64]:
        every = np.concatenate([part.probe_indices for part in self.surface_coverage.iterate_painted()])
        return every[: self.surface_coverage.surface.vertex_count]

    def to_dict(self) -> dict[str, Any]:
        """Return the metrics for JSON, with units in the key names."""
        return {
            "frames_used": self.frame_count,
            "frames_skipped": [one.to_dict() for one in self.skipped],
            "surface_m2": self.surface_area,
            "spread_median_m": self.spread_median,
            "spread_95_m": self.spread_95,
            "weakly_observed_m2": self.weak_areas,
            "missing_m2": self.missing_areas,
            "scan_ends_m2": self.scan_end_area,
            "few_frames": self.limits.min_frames,
            "oblique_deg": float(np.degrees(np.arccos(self.limits.min_cosine))),
            "far_m": self.limits.max_distance,
            "spread_m": self.limits.max_spread,
            "min_area_m2": self.min_area,
            "max_patch_size_m": self.max_patch_size,
            "spacing_m": self.spacing,
            "places_omitted": self.omitted_count,
            "places": [place.to_dict() for place in self.defects],
        }
