"""Ranking of the frames that came nearest to observing a defect."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.views import Floats, Singles, View
from scanloom.stages.scans.model.scan import Camera

# Number of points of a defect that are projected into each frame.
_POINTS = 24
# Relative depth difference below which two depths count as the same surface.
_SAME_DEPTH = 0.03
# float16 halves the memory per frame and is precise enough to detect occluders.
_Halves = NDArray[np.float16]
# Degrees outside the image at which the score halves.
_OUTSIDE = 20.0
# Degrees to the normal. From this angle on, a surface is effectively invisible.
_EDGE_ON = 86.0


@dataclass(frozen=True, eq=False)
class Remembered:
    """Pose and coarse depth map of a frame, for ranking.

    The full depth map is freed once a frame has been added.

    Attributes
    ----------
    number : index of the frame in the input.
    name, camera, place, turn, shift, step : as in `View`.
    coarse : (h', w') float16, coarse depth in metres.
    """

    number: int
    name: str
    camera: Camera
    place: Floats
    turn: Singles
    shift: Singles
    coarse: _Halves
    step: int

    @classmethod
    def of(cls, number: int, view: View) -> Remembered:
        """Keep the part of a view that ranking needs."""
        coarse = view.coarse.astype(np.float16)
        return cls(number, view.name, view.camera, view.place, view.turn, view.shift, coarse, view.step)


@dataclass(frozen=True)
class Look:
    """View of one frame towards a defect.

    Attributes
    ----------
    frame : name of the frame.
    share : ratio of the defect's points inside the image.
    angle : angle between the defect's normal and the line of sight, degrees.
    distance : metres.
    why : what the frame observed, or the reason why it observed nothing.
    """

    frame: str
    share: float
    angle: float
    distance: float
    why: str

    def figures(self) -> dict[str, Any]:
        """Return the values for JSON, with units in the key names."""
        return {
            "frame": self.frame,
            "in_picture_share": round(self.share, 3),
            "angle_deg": round(self.angle, 1),
            "distance_m": self.distance,
            "why": self.why,
        }


@dataclass(frozen=True, eq=False)
class Looks:
    """Views of all frames towards a defect.

    Attributes
    ----------
    nearest : frames that came nearest to observing the defect, the best first.
    in_picture : number of frames with at least half of the defect in the image.
    """

    nearest: tuple[Look, ...]
    in_picture: int


def looks_at(
    points: Floats, normal: Floats, frames: Sequence[Remembered], origin: Floats, count: int
) -> Looks:
    """Rank frames by how well they observe a defect.

    Parameters
    ----------
    points : (k, 3) points of the defect relative to `origin`, metres.
    normal : (3,) direction towards the viewer.
    frames : poses and coarse depth maps.
    origin : (3,) metres.
    count : number of nearest frames to return.
    """
    rows = sample_evenly(len(points), _POINTS)
    chosen = points[rows].astype(np.float32)
    middle = chosen.mean(axis=0).astype(np.float64)
    scored: list[tuple[float, int, Look]] = []
    in_picture = 0
    for frame in frames:
        towards = frame.place - origin - middle
        distance = float(np.linalg.norm(towards))
        cosine = float(normal @ towards) / max(distance, 1e-9)
        outside, share, states = _looked_up(chosen, frame)
        in_picture += share >= 0.5
        angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
        score, why = _judged(share, outside, angle, states)
        # A camera behind the surface cannot observe it.
        score *= 0.5 + 0.5 * cosine if cosine > 0 else 0.25
        scored.append((-score, frame.number, Look(frame.name, share, angle, distance, why)))
    scored.sort(key=lambda one: one[:2])
    nearest = tuple(look for _, _, look in scored[:count])
    return Looks(nearest, in_picture)


@dataclass(frozen=True, eq=False)
class _States:
    """State of the points inside an image: depth missing, occluded, or consistent.

    `gap` is the median distance from the occluder to the occluded points, metres.
    """

    missing: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    agrees: NDArray[np.bool_]
    gap: float


def _looked_up(points: Singles, frame: Remembered) -> tuple[float, float, _States]:
    """Project points into a frame and classify them against its depth map.

    Returns
    -------
    Angle of the nearest point outside the image in degrees, ratio of the points inside, and their states.
    """
    camera = frame.camera
    x, y, z = frame.turn @ points.T + frame.shift[:, None]
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
    pixels = [((c[inside] + 0.5) // frame.step).astype(np.int64) for c in (rows, columns)]
    depth = frame.coarse[pixels[0], pixels[1]].astype(np.float64)
    hidden = (depth > 0) & (depth < at * (1 - _SAME_DEPTH))
    states = _States(
        missing=depth == 0,
        hidden=hidden,
        agrees=(depth > 0) & (np.abs(depth - at) <= _SAME_DEPTH * at),
        gap=float(np.median((at - depth)[hidden])) if hidden.any() else 0.0,
    )
    return outside, float(inside.mean()), states


def _judged(share: float, outside: float, angle: float, states: _States) -> tuple[float, str]:
    """Score how close a frame came to observing a defect.

    Returns the score (0 to 3), and the observation or obstacle as text.
    """
    if share == 0:
        where = f"{outside:.0f}° outside the image"
        return 0.5 * _OUTSIDE / (_OUTSIDE + outside), where
    agrees, missing, hidden = (float(part.mean()) for part in (states.agrees, states.missing, states.hidden))
    if angle >= _EDGE_ON and not missing:
        why = "camera is behind the surface" if angle > 180 - _EDGE_ON else "surface is edge-on"
    elif agrees >= max(missing, hidden, 1e-9):
        why = f"observes a surface there, at {angle:.0f}°"
    elif hidden >= missing and hidden > 0:
        why = f"occluded by something {states.gap:.2g} m in front"
    elif missing > 0:
        why = "no depth there"
    else:
        why = "free space there"
    if share < 0.5:
        why += f"; {share:.0%} of the defect is in the image"
    return share * (1 + 2 * agrees + 0.5 * missing), why
