"""Coverage defect: location, nearest frames and suggested viewpoint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scanloom.stages.inspecting.coverage.kinds import KINDS
from scanloom.stages.inspecting.coverage.nearest import Look, Looks
from scanloom.stages.inspecting.coverage.patches import Patch
from scanloom.stages.inspecting.coverage.standpoints import Standpoint
from scanloom.stages.inspecting.coverage.views import Floats
from scanloom.stages.printing import by_figures

Point = tuple[float, float, float]


@dataclass(frozen=True)
class Place:
    """Coverage defect that should be captured again.

    Attributes
    ----------
    kind : key of `KINDS`.
    point : point of the defect nearest to its centroid, world coordinates, metres.
    normal : (3,) unit vector towards the viewer.
    area : m².
    extent : longest side of the bounding box, metres.
    looks : frames that came nearest to observing the defect, with the reasons why they did not.
    frames_towards : number of frames with at least half of the defect in the image, occluded or not.
    stand : suggested viewpoint.
    """

    kind: str
    point: Point
    normal: Point
    area: float
    extent: float
    looks: tuple[Look, ...]
    frames_towards: int
    stand: Standpoint

    __repr__ = by_figures

    @property
    def why(self) -> str:
        """Short description of the defect."""
        return KINDS[self.kind].text

    def figures(self) -> dict[str, Any]:
        """Return the defect for JSON, with units in the key names."""
        return {
            "kind": self.kind,
            "why": self.why,
            "area_m2": self.area,
            "weight": KINDS[self.kind].weight,
            "point_m": list(self.point),
            "normal": list(self.normal),
            "extent_m": self.extent,
            "frames_towards": self.frames_towards,
            "nearest_frames": [look.figures() for look in self.looks],
            "look_from_m": list(self.stand.position),
            "look_direction": list(self.stand.direction),
            "look_sees_share": self.stand.sees,
            "look_from_is_free": self.stand.is_free,
        }


def place_of(patch: Patch, looks: Looks, stand: Standpoint, origin: Floats) -> Place:
    """Convert a patch, given relative to `origin`, into a reported defect."""
    return Place(
        kind=patch.kind,
        point=_point(patch.middle + origin),
        normal=_point(patch.normal),
        area=patch.area,
        extent=patch.extent,
        looks=looks.nearest,
        frames_towards=looks.in_picture,
        stand=stand,
    )


def _point(values: Floats) -> Point:
    x, y, z = (round(float(value), 4) for value in values)
    return x, y, z
