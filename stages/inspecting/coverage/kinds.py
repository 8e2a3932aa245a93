"""Kinds of coverage defects, with weights, texts and colours."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """Kind of a coverage defect.

    Attributes
    ----------
    weight : importance per square metre, for ranking.
    text : short description for people.
    color : RGB colour on the painted mesh.
    word : name of the colour.
    """

    weight: float
    text: str
    color: tuple[int, int, int]
    word: str


# Missing surface of the scanned object has the highest weights, weakly observed surface lower ones. Beyond
# the end of a scan there may be nothing to measure (outdoors, the sky), so "end" has the lowest.
KINDS = {
    "hole": Kind(1.0, "hole in the surface", (214, 39, 40), "red"),
    "hidden": Kind(0.7, "occluded in all frames", (148, 40, 140), "purple"),
    "gap": Kind(0.8, "gap between two borders", (235, 110, 190), "pink"),
    "blank": Kind(0.5, "no depth in any frame", (90, 70, 210), "violet"),
    "unseen": Kind(0.3, "outside the view of all frames", (150, 110, 80), "brown"),
    "end": Kind(0.1, "no depth at the end of the scan", (190, 150, 210), "lilac"),
    "unmeasured": Kind(0.6, "not measured by any frame", (255, 127, 14), "orange"),
    "few": Kind(0.4, "measured by few frames", (245, 205, 60), "yellow"),
    "oblique": Kind(0.3, "observed only obliquely", (86, 180, 233), "light blue"),
    "far": Kind(0.3, "observed only from far", (0, 90, 170), "dark blue"),
    "apart": Kind(0.3, "frames disagree about its depth", (0, 140, 125), "teal"),
}
MISSING = ("hole", "hidden", "gap", "blank", "unseen", "end")
THIN = ("unmeasured", "few", "oblique", "far", "apart")
# RGB colour of well-observed surface.
WELL = (196, 200, 196)
