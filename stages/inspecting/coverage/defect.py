"""Coverage defect: location, nearest frames and suggested viewpoint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from scanloom.stages.inspecting.coverage.capture_viewpoints import CaptureViewpoint
from scanloom.stages.inspecting.coverage.defect_kinds import DEFECT_KINDS
from scanloom.stages.inspecting.coverage.defect_patches import DefectPatch
from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.inspecting.coverage.frame_ranking import FrameView, FrameViews
from scanloom.stages.printing import format_by_metrics

Point = tuple[float, float, float]


@dataclass(frozen=True)
class CoverageDefect:
    """Coverage defect that should be captured again.

    Attributes
    ----------
    kind : key of `DEFECT_KINDS`.
    point : point of the defect nearest to its centroid, world coordinates, metres.
    normal : (3,) unit vector towards the viewer.
    area : m².
    extent : longest side of the bounding box, metres.
    nearest_frames : frames that came nearest to observing the defect, with the reasons why they did not.
    frames_in_view : number of frames with at least half of the defect in the image, occluded or not.
    viewpoint : suggested viewpoint.
    """

    kind: str
    point: Point
    normal: Point
    area: float
    extent: float
    nearest_frames: tuple[FrameView, ...]
    frames_in_view: int
    viewpoint: CaptureViewpoint

    __repr__ = format_by_metrics

    @property
    def description(self) -> str:
        """Short description of the defect."""
        return DEFECT_KINDS[self.kind].description

    def to_dict(self) -> dict[str, Any]:
        """Return the defect for JSON, with units in the key names."""
        return {
            "kind": self.kind,
            "why": self.description,
            "area_m2": self.area,
            "weight": DEFECT_KINDS[self.kind].weight,
            "point_m": list(self.point),
            "normal": list(self.normal),
            "extent_m": self.extent,
            "frames_in_view": self.frames_in_view,
            "nearest_frames": [look.to_dict() for look in self.nearest_frames],
            "viewpoint_m": list(self.viewpoint.position),
            "view_direction": list(self.viewpoint.direction),
            "visible_ratio": self.viewpoint.visible_ratio,
            "viewpoint_is_free": self.viewpoint.is_free,
        }


def build_defect(
    patch: DefectPatch, frame_views: FrameViews, viewpoint: CaptureViewpoint, origin: Floats
) -> CoverageDefect:
    """Convert a patch, given relative to `origin`, into a reported defect."""
    return CoverageDefect(
        kind=patch.kind,
        point=_to_point(patch.middle + origin),
        normal=_to_point(patch.normal),
        area=patch.area,
        extent=patch.extent,
        nearest_frames=frame_views.nearest,
        frames_in_view=frame_views.in_view_count,
        viewpoint=viewpoint,
    )


def _to_point(values: Floats) -> Point:
    x, y, z = (round(float(value), 4) for value in values)
    return x, y, z
