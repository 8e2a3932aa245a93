"""Which frames came nearest to seeing a place, and what kept them from it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.frames.sampling import sample_evenly
from scanloom.stages.inspecting.coverage.views import Floats, Singles, View
from scanloom.stages.scans.model.scan import Camera

# Points of a place that are looked up in each frame.
_POINTS = 24
# Of a depth: what differs by less is the same surface.
_SAME_DEPTH = 0.03
# Half precision is enough to tell what was before a place.
_Halves = NDArray[np.float16]
# Degrees that a place may be out of a picture and still count half of one that is in it.
_OUTSIDE = 20.0
# Degrees to the normal, from which on nothing is seen of a surface.
_EDGE_ON = 86.0


@dataclass(frozen=True, eq=False)
class Remembered:
    """What is kept of a frame for later: where it stood, and its coarse depth.

    Attributes
    ----------
    number : of the frame among those given.
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
        """Return what is kept of a view."""
        coarse = view.coarse.astype(np.float16)
        return cls(number, view.name, view.camera, view.place, view.turn, view.shift, coarse, view.step)


@dataclass(frozen=True)
class Look:
    """How a frame came near to seeing a place.

    Attributes
    ----------
    frame : its name.
    share : of the place that is in its picture.
    angle : degrees between the place's normal and the line to the camera.
    distance : metres.
    why : what it saw of the place, or kept it from that.
    """

    frame: str
    share: float
    angle: float
    distance: float
    why: str

    def figures(self) -> dict[str, Any]:
        """Return it for JSON, units in the names."""
        return {
            "frame": self.frame,
            "in_picture_share": round(self.share, 3),
            "angle_deg": round(self.angle, 1),
            "distance_m": self.distance,
            "why": self.why,
        }


@dataclass(frozen=True, eq=False)
class Looks:
    """How all frames look at a place.

    Attributes
    ----------
    nearest : the frames that came nearest to seeing it, the best first.
    in_picture : how many frames have half of it in their picture.
    """

    nearest: tuple[Look, ...]
    in_picture: int


def looks_at(
    points: Floats, normal: Floats, frames: Sequence[Remembered], origin: Floats, count: int
) -> Looks:
    """Return how frames look at a place.

    Parameters
    ----------
    points : (k, 3) of it, metres, from the origin on.
    normal : (3,) to where one looks at it from.
    count : of the nearest frames that are told.
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
        # From behind, nothing can be seen of it.
        score *= 0.5 + 0.5 * cosine if cosine > 0 else 0.25
        scored.append((-score, frame.number, Look(frame.name, share, angle, distance, why)))
    scored.sort(key=lambda one: one[:2])
    nearest = tuple(look for _, _, look in scored[:count])
    return Looks(nearest, in_picture)


@dataclass(frozen=True, eq=False)
class _States:
    """Of the points that are in a picture: whether there is no depth, something before, or it agrees."""

    missing: NDArray[np.bool_]
    hidden: NDArray[np.bool_]
    agrees: NDArray[np.bool_]
    gap: float


def _looked_up(points: Singles, frame: Remembered) -> tuple[float, float, _States]:
    """Return how far out of the picture the nearest point is, degrees, the share in it, and what is there."""
    camera = frame.camera
    x, y, z = frame.turn @ points.T + frame.shift[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        columns, rows = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        # Where the edge of the picture is nearest to a point, both as directions.
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
    """Return how near a frame came to seeing a place, up to 3, and what kept it from that."""
    if share == 0:
        where = f"it is {outside:.0f}° outside its picture"
        return 0.5 * _OUTSIDE / (_OUTSIDE + outside), where
    agrees, missing, hidden = (float(part.mean()) for part in (states.agrees, states.missing, states.hidden))
    if angle >= _EDGE_ON and not missing:
        why = "stands behind it" if angle > 180 - _EDGE_ON else "sees it edge-on"
    elif agrees >= max(missing, hidden, 1e-9):
        why = f"sees something there, at {angle:.0f}°"
    elif hidden >= missing and hidden > 0:
        why = f"something {states.gap:.2g} m before it hides it"
    elif missing > 0:
        why = "has no depth there"
    else:
        why = "looks through it"
    if share < 0.5:
        why += f"; {share:.0%} of it is in its picture"
    return share * (1 + 2 * agrees + 0.5 * missing), why
