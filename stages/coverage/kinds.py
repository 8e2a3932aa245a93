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
    """

    weight: float
    text: str
    color: tuple[int, int, int]


# What is not there at all counts whole; what is there, but hardly seen, less.
KINDS = {
    "hole": Kind(1.0, "hole in the surface", (214, 39, 40)),
    "hidden": Kind(1.0, "hidden from all frames", (148, 40, 140)),
    "blank": Kind(1.0, "frames have no depth there", (120, 60, 200)),
    "unseen": Kind(1.0, "no frame looked there", (227, 90, 190)),
    "unmeasured": Kind(0.6, "no frame measured it", (255, 127, 14)),
    "few": Kind(0.4, "few frames measured it", (247, 182, 60)),
    "oblique": Kind(0.3, "only seen obliquely", (86, 180, 233)),
    "far": Kind(0.3, "only seen from far", (0, 90, 170)),
}
MISSING = ("hole", "hidden", "blank", "unseen")
THIN = ("unmeasured", "few", "oblique", "far")
# Of what is well.
WELL = (196, 200, 196)
