"""A place of a scan where something is missing, and what is known of it."""

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
    """A place where one should go again.

    Attributes
    ----------
    kind : of `scanloom.stages.inspecting.coverage.kinds`.
    point : in the middle of it, in the scan's world, metres.
    normal : (3,) unit, to where one looks at it from.
    area : m².
    extent : metres, of the longest side of the box around it.
    looks : the frames that came nearest to seeing it, and what kept them from it.
    frames_towards : how many frames have half of it in their picture, whatever is before it.
    stand : from where one should look.
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
        """Return what is wrong with it, in a few words."""
        return KINDS[self.kind].text

    def figures(self) -> dict[str, Any]:
        """Return it for JSON, units in the names."""
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
    """Return what is known of a patch as a place; its points are counted from `origin`."""
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
