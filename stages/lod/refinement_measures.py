"""Refinement measures of nodes after Wang, Lu and Pan (2012, section 2.2).

In some places the paper's text and formulas disagree, or a formula does the opposite of its purpose. The
corrected formula is the default there, and the paper's formula is an option.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.lod.view import View

Floats = NDArray[np.float64]
Rule = Literal["corrected", "paper"]

# Thresholds of the paper: error in pixels, ratio of marked vertices, and local measure.
MAX_ERROR_PX = 0.82
MAX_MARKED_RATIO = 0.5
SPLIT_THRESHOLD = 0.75


@dataclass(frozen=True, eq=False)
class RefinementWeights:
    """Measures of each node, and the resulting refinement priority.

    Attributes
    ----------
    frustum : (n,) gamma_v, visible ratio, 0 to 1.
    silhouette : (n,) gamma_s, proximity to the silhouette, 0 to 1.
    error_px : (n,) gamma_g, pixels.
    marked : (n,) lambda_d, 0 to 1.
    local : (n,) lambda_L; a node is split above a threshold.
    """

    frustum: Floats
    silhouette: Floats
    error_px: Floats
    marked: Floats
    local: Floats


def compute_global_limit(triangles: int, floor: int, distance: float, *, near: float, far: float) -> float:
    """Compute lambda_G, the triangle limit of a model at a distance.

    The limit is `triangles` up to `near`, `floor` from `far` on, and linear in between. Distances are in
    metres.
    """
    ratio = float(np.clip((far - distance) / (far - near), 0.0, 1.0)) if far > near else 0.0
    return floor + ratio * (triangles - floor)


def compute_frustum_ratio(
    view: View, middle: Floats, radius: Floats, points: tuple[Floats, ...] = ()
) -> Floats:
    """Compute gamma_v, equations (1) and (2): the ratio of each node inside the view frustum.

    Parameters
    ----------
    view : view to test against.
    middle, radius : (n, 3) and (n,) bounding spheres, metres. The ratio is 0 for spheres outside.
    points : (k, 3) points of each node for the ratio. Without points, a sphere that is not outside counts as
        1.
    """
    seen = view.intersects(middle, radius).astype(np.float64)
    if not points:
        return seen
    normals, offsets = view.compute_planes()
    for node in np.flatnonzero(seen):
        inside = (points[node] @ normals.T <= offsets).all(axis=1)
        seen[node] = float(inside.mean()) if len(inside) else 0.0
    return seen


def compute_silhouette_weight(
    view: View,
    middle: Floats,
    radius: Floats,
    axis: Floats,
    half_angle: Floats,
    *,
    rule: Rule = "corrected",
) -> Floats:
    """Compute gamma_s, equation (3), from bounding spheres and normal cones.

    theta is the angle between the viewing direction and the cone's axis, alpha the half angle of the cone,
    and beta the angle the sphere spans at the eye. If theta + alpha + beta < 90°, the node is back-facing: 0.
    If theta - alpha - beta > 90°, the node is front-facing: 1 in the paper.

    In between, the paper's -cos(theta) is negative for theta < 90°, so nodes at the silhouette weigh less
    than back-facing ones. The corrected rule follows the paper's intention: 1 where the silhouette may be.
    Front-facing nodes get sin(theta), at least 0.5, which increases towards the silhouette.

    Parameters
    ----------
    view : view with the eye position.
    middle, radius : (n, 3) and (n,) bounding spheres, metres.
    axis, half_angle : (n, 3) and (n,) normal cones, radians.
    rule : "corrected" or "paper".
    """
    towards = middle - np.asarray(view.eye)
    distance = np.linalg.norm(towards, axis=1)
    inside = distance <= radius
    safe_distance = np.maximum(distance, np.finfo(np.float64).tiny)
    cosine = np.clip(np.einsum("ij,ij->i", towards, axis) / safe_distance, -1, 1)
    theta = np.arccos(cosine)
    beta = np.arcsin(np.clip(radius / safe_distance, 0, 1))
    is_back_facing = theta + half_angle + beta < 0.5 * np.pi
    is_front_facing = theta - half_angle - beta > 0.5 * np.pi
    if rule == "paper":
        found = np.where(is_back_facing, 0.0, np.where(is_front_facing, 1.0, -cosine))
    else:
        found = np.where(is_back_facing, 0.0, np.where(is_front_facing, np.maximum(0.5, np.sin(theta)), 1.0))
    return np.asarray(np.where(inside, 1.0, found))


def compute_marked_ratio(marked: Floats, vertices: Floats, *, rule: Rule = "corrected") -> Floats:
    """Compute lambda_d = d1 d2, equation (4), from numbers of marked vertices (n,).

    d1 is 1 if any vertex is marked. In the paper, d2 is the node's ratio of all marked vertices (the count at
    the root, the first node). No leaf then exceeds 0.5 once three nodes share the region. The corrected d2 is
    the ratio of the node's own `vertices` (n,) that are marked.
    """
    totals = np.full(len(marked), marked.max(initial=0.0)) if rule == "paper" else vertices
    return np.asarray(np.divide(marked, totals, out=np.zeros(len(marked)), where=(totals > 0) & (marked > 0)))


def compute_local_measure(
    frustum: Floats,
    silhouette: Floats,
    error_px: Floats,
    marked: Floats,
    *,
    max_error_px: float = MAX_ERROR_PX,
    max_marked_ratio: float = MAX_MARKED_RATIO,
    rule: Rule = "corrected",
) -> Floats:
    """Compute lambda_L, equation (5), from the other measures.

    It is 1 above either threshold, else the maximum of gamma_v gamma_s and lambda_d. By the corrected rule,
    invisible nodes have no error in pixels; in the paper their error counts, too.
    """
    too_far = error_px > max_error_px
    if rule == "corrected":
        too_far &= frustum > 0
    urgent = too_far | (marked > max_marked_ratio)
    return np.asarray(np.where(urgent, 1.0, np.maximum(frustum * silhouette, marked)))
