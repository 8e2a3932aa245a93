"""What is missing in a scan, as it was found."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.inspecting.coverage.evidence import Evidence
from stages.inspecting.coverage.place import Place
from stages.inspecting.coverage.thin import Limits
from stages.printing import by_figures, table
from stages.scans.scan import SkippedFrame
from stages.surface.mesh import Mesh


@dataclass(frozen=True, eq=False)
class Coverage:
    """What is missing in a scan.

    Attributes
    ----------
    places : where to go again, the most important first.
    left_out : how many places are not told, beyond as many as were asked for.
    evidence : what frames have measured of each vertex.
    kinds : (n,) int8, which of `stages.inspecting.coverage.kinds.THIN` each vertex is; -1 for well seen.
    painted : the mesh in colours of that, and behind its triangles what would close its holes.
    limits : what counted as thin.
    least_area, place_size, spacing : m² and metres, as given or derived.
    frames : how many were looked at.
    skipped : those that were not, and why.
    surface_area : m².
    thin_areas : m² of the surface, by kind.
    missing_areas : m² of what is not there at all, by kind; also of places that are not told.
    ends_area : m² where the scan ends: nobody measured anything beyond, and it is open to the other side.
    """

    places: tuple[Place, ...]
    left_out: int
    evidence: Evidence
    kinds: NDArray[np.int8]
    painted: Mesh
    limits: Limits
    least_area: float
    place_size: float
    spacing: float
    frames: int
    skipped: tuple[SkippedFrame, ...]
    surface_area: float
    thin_areas: dict[str, float]
    missing_areas: dict[str, float]
    ends_area: float

    __repr__ = by_figures
    _repr_html_ = table

    def figures(self) -> dict[str, Any]:
        """Return what there is to say, for JSON, units in the names."""
        return {
            "frames_used": self.frames,
            "frames_skipped": [{"frame": one.name, "reason": one.reason} for one in self.skipped],
            "surface_m2": self.surface_area,
            "thin_m2": self.thin_areas,
            "missing_m2": self.missing_areas,
            "scan_ends_m2": self.ends_area,
            "few_frames": self.limits.frames,
            "oblique_deg": float(np.degrees(np.arccos(self.limits.cosine))),
            "far_m": self.limits.distance,
            "least_area_m2": self.least_area,
            "place_size_m": self.place_size,
            "spacing_m": self.spacing,
            "places_left_out": self.left_out,
            "places": [place.figures() for place in self.places],
        }
