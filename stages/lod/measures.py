"""How urgent it is to refine a node: the measures of Wang, Lu and Pan (2012, section 2.2).

Where the paper's text and formulas disagree, or a formula does the opposite of what it is for, the corrected
one is the default and the paper's letter an option.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.lod.view import View

Floats = NDArray[np.float64]
Rule = Literal["corrected", "paper"]

# The paper's thresholds: of the error, in pixels, of the share of marked vertices, and of the local measure.
ERROR_PX = 0.82
MARKED_SHARE = 0.5
SPLIT_ABOVE = 0.75


@dataclass(frozen=True, eq=False)
class Weights:
    """The measures of each node, and what follows from them.

    Attributes
    ----------
    frustum : (n,) gamma_v, the share that is seen, 0 to 1.
    silhouette : (n,) gamma_s, how close it is to the outline, 0 to 1.
    error_px : (n,) gamma_g, pixels.
    marked : (n,) lambda_d, 0 to 1.
    local : (n,) lambda_L; a node is split above a threshold.
    """

    frustum: Floats
    silhouette: Floats
    error_px: Floats
    marked: Floats
    local: Floats


def global_limit(triangles: int, floor: int, distance: float, *, near: float, far: float) -> float:
    """Return lambda_G, the triangles that a model may have at a distance: all at `near`, `floor` at `far`.

    Between the two it falls linearly, beyond them it stays.
    """
    share = float(np.clip((far - distance) / (far - near), 0.0, 1.0)) if far > near else 0.0
    return floor + share * (triangles - floor)


def frustum_share(view: View, middle: Floats, radius: Floats, points: tuple[Floats, ...] = ()) -> Floats:
    """Return gamma_v (1), (2): 0 for balls (n, 3), (n,) wholly outside the view, else the share within.

    Without `points` (of each node, (k, 3)), a ball that is not wholly outside counts as within.
    """
    seen = view.sees(middle, radius).astype(np.float64)
    if not points:
        return seen
    normals, offsets = view.planes()
    for node in np.flatnonzero(seen):
        inside = (points[node] @ normals.T <= offsets).all(axis=1)
        seen[node] = float(inside.mean()) if len(inside) else 0.0
    return seen


def silhouette_weight(
    view: View,
    middle: Floats,
    radius: Floats,
    axis: Floats,
    half_angle: Floats,
    *,
    rule: Rule = "corrected",
) -> Floats:
    """Return gamma_s (3) of nodes with balls (n, 3), (n,) and cones of normals (n, 3), (n,) in radians.

    theta is the angle between the direction of view and the cone's axis, alpha the cone, beta what the ball
    spans as seen from the eye. Where theta + alpha + beta < 90°, everything looks away: 0. Where
    theta - alpha - beta > 90°, everything faces the eye: 1 in the paper's letter.

    Between, the paper's -cos(theta) is negative as long as theta < 90°: nodes at the outline weigh less than
    those seen from behind. The corrected rule gives what the paper says it wants: 1 where the outline may be,
    and what faces the eye sin(theta), at least 0.5, the more the closer it is to it.
    """
    towards = middle - np.asarray(view.eye)
    distance = np.linalg.norm(towards, axis=1)
    inside = distance <= radius
    safe = np.maximum(distance, np.finfo(np.float64).tiny)
    cosine = np.clip(np.einsum("ij,ij->i", towards, axis) / safe, -1, 1)
    theta = np.arccos(cosine)
    beta = np.arcsin(np.clip(radius / safe, 0, 1))
    away = theta + half_angle + beta < 0.5 * np.pi
    facing = theta - half_angle - beta > 0.5 * np.pi
    if rule == "paper":
        found = np.where(away, 0.0, np.where(facing, 1.0, -cosine))
    else:
        found = np.where(away, 0.0, np.where(facing, np.maximum(0.5, np.sin(theta)), 1.0))
    return np.asarray(np.where(inside, 1.0, found))


def marked_share(marked: Floats, vertices: Floats, *, rule: Rule = "corrected") -> Floats:
    """Return lambda_d (4) = d1 d2 of nodes with so many marked (n,) of so many vertices (n,).

    d1 is 1 where a vertex is marked. In the paper d2 is the share of all marked vertices (those of the
    root, the first) that the node has, so that no leaf passes 0.5 once the region is split between three; by
    default d2 is the share of the node's own vertices that are marked.
    """
    of = np.full(len(marked), marked.max(initial=0.0)) if rule == "paper" else vertices
    return np.asarray(np.divide(marked, of, out=np.zeros(len(marked)), where=(of > 0) & (marked > 0)))


def local_measure(
    frustum: Floats,
    silhouette: Floats,
    error_px: Floats,
    marked: Floats,
    *,
    most_error_px: float = ERROR_PX,
    most_marked: float = MARKED_SHARE,
    rule: Rule = "corrected",
) -> Floats:
    """Return lambda_L (5): 1 above either threshold, else the larger of gamma_v gamma_s and lambda_d.

    What is not seen at all has no error in pixels: by the paper's letter its error counts all the same.
    """
    too_far = error_px > most_error_px
    if rule == "corrected":
        too_far &= frustum > 0
    urgent = too_far | (marked > most_marked)
    return np.asarray(np.where(urgent, 1.0, np.maximum(frustum * silhouette, marked)))
