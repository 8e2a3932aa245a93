"""Ranking of the frames that came nearest to observing a defect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.depth_view import DepthView, Floats, Singles
from scanloom.stages.scans.model.scan import Camera

# Number of points of a defect that are projected into each frame.
_SAMPLE_COUNT = 24
# Relative depth difference below which two depths count as the same surface.
_DEPTH_TOLERANCE_RATIO = 0.03
# float16 halves the memory per frame and is precise enough to detect occluders.
_HalfFloats = NDArray[np.float16]
# Degrees outside the image at which the score halves.
_HALF_SCORE_ANGLE_DEG = 20.0
# Degrees to the normal. From this angle on, a surface is effectively invisible.
_EDGE_ON_ANGLE_DEG = 86.0


@dataclass(frozen=True, eq=False)
class FrameSummary:
    """Pose and coarse depth map of a frame, for ranking.

    The full depth map is freed once a frame has been added.

    Attributes
    ----------
    index : index of the frame in the input.
    name, camera, position, rotation, translation, downsampling : as in `DepthView`.
    coarse_depth : (h', w') float16, coarse depth in metres.
    """

    index: int
    name: str
    camera: Camera
    position: Floats
    rotation: Singles
    translation: Singles
    coarse_depth: _HalfFloats
    downsampling: int

    @classmethod
    def from_view(cls, index: int, view: DepthView) -> FrameSummary:
        """Keep the part of a view that ranking needs."""
        coarse = view.coarse_depth.astype(np.float16)
        return cls(
            index,
            view.name,
            view.camera,
            view.position,
            view.rotation,
            view.translation,
            coarse,
            view.downsampling,
        )


@dataclass(frozen=True)
class FrameView:
    """View of one frame towards a defect.

    Attributes
    ----------
    frame : name of the frame.
    in_view_ratio : ratio of the defect's points inside the image.
    angle_deg : angle between the defect's normal and the line of sight, degrees.
    distance_m : metres.
    reason : what the frame observed, or the reason why it observed nothing.
    """

    frame: str
    in_view_ratio: float
    angle_deg: float
    distance_m: float
    reason: str

    def to_dict(self) -> dict[str, Any]:
        """Return the values for JSON, with units in the key names."""
        return {
            "frame": self.frame,
            "in_view_ratio": round(self.in_view_ratio, 3),
            "angle_deg": round(self.angle_deg, 1),
            "distance_m": self.distance_m,
            "why": self.reason,
        }


@dataclass(frozen=True, eq=False)
class FrameViews:
    """Views of all frames towards a defect.

    Attributes
    ----------
    nearest : frames that came nearest to observing the defect, the best first.
    in_view_count : number of frames with at least half of the defect in the image.
    """

    nearest: tuple[FrameView, ...]
    in_view_count: int


def rank_frames(
    points: Floats, normal: Floats, frames: Sequence[FrameSummary], origin: Floats, count: int
) -> FrameViews:
    """Rank frames by how well they observe a defect.

    Parameters
    ----------
    points : (k, 3) points of the defect relative to `origin`, metres.
    normal : (3,) direction towards the viewer.
    frames : poses and coarse depth maps.
    origin : (3,) metres.
    count : number of nearest frames to return.
    """
    rows = sample_evenly(len(points), _SAMPLE_COUNT)
    chosen = points[rows].astype(np.float32)
    middle = chosen.mean(axis=0).astype(np.float64)
    scored: list[tuple[float, int, FrameView]] = []
    in_picture = 0
    for frame in frames:
        towards = frame.position - origin - middle
        distance = float(np.linalg.norm(towards))
        cosine = float(normal @ towards) / max(distance, 1e-9)
        angle_outside_deg, in_view_ratio, states = _classify_points(chosen, frame)
        in_picture += in_view_ratio >= 0.5
        angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        score, why = _score_view(in_view_ratio, angle_outside_deg, angle, states)
        # A camera behind the surface cannot observe it.
        score *= 0.5 + 0.5 * cosine if cosine > 0 else 0.25
        scored.append((-score, frame.index, FrameView(frame.name, in_view_ratio, angle, distance, why)))
    scored.sort(key=lambda one: one[:2])
    nearest = tuple(look for _, _, look in scored[:count])
    return FrameViews(nearest, in_picture)


@dataclass(frozen=True, eq=False)
class _PointStates:
    """State of the points inside an image: depth missing, occluded, or consistent.

    `occluder_distance_m` is the median distance from the occluder to the occluded points, metres.
    """

    is_missing: NDArray[np.bool_]
    is_occluded: NDArray[np.bool_]
    is_consistent: NDArray[np.bool_]
    occluder_distance_m: float


def _classify_points(points: Singles, frame: FrameSummary) -> tuple[float, float, _PointStates]:
    """Project points into a frame and classify them against its depth map.

    Returns
    -------
    Angle of the nearest point outside the image in degrees, ratio of the points inside, and their states.
    """
    camera = frame.camera
    x, y, z = frame.rotation @ points.T + frame.translation[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        columns, rows = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        # Nearest point on the image border, for the angle between both directions.
        u = columns.clip(-0.5, camera.width - 0.5)
        v = rows.clip(-0.5, camera.height - 0.5)
    u = np.where(z > 0, u, np.where(x > 0, camera.width - 0.5, -0.5))
    v = np.where(z > 0, v, np.where(y > 0, camera.height - 0.5, -0.5))
    edge = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)])
    length = np.sqrt((edge**2).sum(axis=0) * (x * x + y * y + z * z))
    cosines = (edge[0] * x + edge[1] * y + z) / np.maximum(length, 1e-12)
    outside = float(np.degrees(np.arccos(cosines.clip(-1, 1))).min())
    inside = (z > 0) & (columns > -0.5) & (rows > -0.5)
    inside &= (columns < camera.width - 0.5) & (rows < camera.height - 0.5)
    at = z[inside]
    pixels = [((c[inside] + 0.5) // frame.downsampling).astype(np.int64) for c in (rows, columns)]
    depth = frame.coarse_depth[pixels[0], pixels[1]].astype(np.float64)
    hidden = (depth > 0) & (depth < at * (1 - _DEPTH_TOLERANCE_RATIO))
    states = _PointStates(
        is_missing=depth == 0,
        is_occluded=hidden,
        is_consistent=(depth > 0) & (np.abs(depth - at) <= _DEPTH_TOLERANCE_RATIO * at),
        occluder_distance_m=float(np.median((at - depth)[hidden])) if hidden.any() else 0.0,
    )
    return outside, float(inside.mean()), states


def _score_view(
    in_view_ratio: float, angle_outside_deg: float, angle_deg: float, states: _PointStates
) -> tuple[float, str]:
    """Score how close a frame came to observing a defect.

    Returns the score (0 to 3), and the observation or obstacle as text.
    """
    if in_view_ratio == 0:
        where = f"{angle_outside_deg:.0f}° outside the image"
        return 0.5 * _HALF_SCORE_ANGLE_DEG / (_HALF_SCORE_ANGLE_DEG + angle_outside_deg), where
    agrees, missing, hidden = (
        float(part.mean()) for part in (states.is_consistent, states.is_missing, states.is_occluded)
    )
    if angle_deg >= _EDGE_ON_ANGLE_DEG and not missing:
        why = "camera is behind the surface" if angle_deg > 180 - _EDGE_ON_ANGLE_DEG else "surface is edge-on"
    elif agrees >= max(missing, hidden, 1e-9):
        why = f"observes a surface there, at {angle_deg:.0f}°"
    elif hidden >= missing and hidden > 0:
        why = f"occluded by something {states.occluder_distance_m:.2g} m in front"
    elif missing > 0:
        why = "no depth there"
    else:
        why = "free space there"
    if in_view_ratio < 0.5:
        why += f"; {in_view_ratio:.0%} of the defect is in the image"
    return in_view_ratio * (1 + 2 * agrees + 0.5 * missing), why
