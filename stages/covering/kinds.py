"""What can be wrong with a place, how much it counts beside others of its size, and how it is said."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Kind:
    """A kind of place.

    Attributes
    ----------
    weight : how much a square metre of it counts.
    text : what is wrong, in a few words.
    color : of it on the mesh.
    word : for that colour.
    """

    weight: float
    text: str
    color: tuple[int, int, int]
    word: str


# What is not there at all counts whole; what is there, but hardly seen, less.
KINDS = {
    "hole": Kind(1.0, "hole in the surface", (214, 39, 40), "red"),
    "hidden": Kind(1.0, "hidden from all frames", (148, 40, 140), "purple"),
    "blank": Kind(1.0, "frames have no depth there", (90, 70, 210), "violet"),
    "unseen": Kind(1.0, "no frame looked there", (235, 110, 190), "pink"),
    "unmeasured": Kind(0.6, "no frame measured it", (255, 127, 14), "orange"),
    "few": Kind(0.4, "few frames measured it", (245, 205, 60), "yellow"),
    "oblique": Kind(0.3, "only seen obliquely", (86, 180, 233), "light blue"),
    "far": Kind(0.3, "only seen from far", (0, 90, 170), "dark blue"),
}
MISSING = ("hole", "hidden", "blank", "unseen")
THIN = ("unmeasured", "few", "oblique", "far")
# Of what is well.
WELL = (196, 200, 196)
