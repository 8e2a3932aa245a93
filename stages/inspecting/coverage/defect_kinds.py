"""Kinds of coverage defects, with weights, texts and colours."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DefectKind:
    """Kind of a coverage defect.

    Attributes
    ----------
    weight : importance per square metre, for ranking.
    description : short description for people.
    color : RGB colour on the painted mesh.
    color_name : name of the colour.
    """

    weight: float
    description: str
    color: tuple[int, int, int]
    color_name: str


# Missing surface of the scanned object has the highest weights, weakly observed surface lower ones. Beyond
# the end of a scan there may be nothing to measure (outdoors, the sky), so "end" has the lowest.
DEFECT_KINDS = {
    "hole": DefectKind(1.0, "hole in the surface", (214, 39, 40), "red"),
    "hidden": DefectKind(0.7, "occluded in all frames", (148, 40, 140), "purple"),
    "gap": DefectKind(0.8, "gap between two borders", (235, 110, 190), "pink"),
    "blank": DefectKind(0.5, "no depth in any frame", (90, 70, 210), "violet"),
    "unseen": DefectKind(0.3, "outside the view of all frames", (150, 110, 80), "brown"),
    "end": DefectKind(0.1, "no depth at the end of the scan", (190, 150, 210), "lilac"),
    "unmeasured": DefectKind(0.6, "not measured by any frame", (255, 127, 14), "orange"),
    "few": DefectKind(0.4, "measured by few frames", (245, 205, 60), "yellow"),
    "oblique": DefectKind(0.3, "observed only obliquely", (86, 180, 233), "light blue"),
    "far": DefectKind(0.3, "observed only from far", (0, 90, 170), "dark blue"),
    "apart": DefectKind(0.3, "frames disagree about its depth", (0, 140, 125), "teal"),
}
MISSING_KINDS = ("hole", "hidden", "gap", "blank", "unseen", "end")
WEAK_KINDS = ("unmeasured", "few", "oblique", "far", "apart")
# RGB colour of well-observed surface.
WELL_OBSERVED_COLOR = (196, 200, 196)
