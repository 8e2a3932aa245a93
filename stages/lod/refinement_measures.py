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
    marked : (n,) lambda_d, 0 to 1: participation in a deformation.
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
    view: View,
    middle: Floats,
    radius: Floats,
    inside: Floats | None = None,
    vertices: Floats | None = None,
) -> Floats:
    """Compute gamma_v, equations (1) and (2): the ratio of each node inside the view frustum.

    Parameters
    ----------
    view : view to test against.
    middle, radius : (n, 3) and (n,) bounding spheres, metres.
    inside, vertices : (n,) numbers of vertices inside the frustum, and of all vertices. With both, the ratio
        is the paper's: 1 for spheres that are inside all four sides of the frustum by equation (1), else the
        ratio of the vertices inside. Without, spheres that may meet the frustum count as 1, others as 0.
    """
    if inside is None or vertices is None:
        return view.intersects(middle, radius).astype(np.float64)
    normals, offsets = view.compute_planes()
    is_within_sides = (middle @ normals[:4].T - offsets[:4] < -radius[:, None]).all(axis=1)
    return np.where(is_within_sides, 1.0, _divide_counts(inside, vertices))


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


def compute_marked_weight(
    is_handle: NDArray[np.bool_], constrained: Floats, vertices: Floats, *, rule: Rule = "corrected"
) -> Floats:
    """Compute lambda_d = d1 d2, equation (4), of nodes (n,).

    In the paper, d1 is 1 for nodes of the handle and 0 for others, and d2 is the ratio of the constrained
    vertices that belong to the node (relative to their number at the root, the first node). If three nodes
    share the constrained vertices, no leaf exceeds 0.5, and the handle is not refined.

    By the corrected rule, nodes of the handle weigh 1, and are therefore refined completely. Other nodes
    weigh the ratio of their own vertices that are constrained.

    Parameters
    ----------
    is_handle : (n,) nodes with a vertex in the handle.
    constrained, vertices : (n,) numbers of constrained vertices, and of all vertices.
    rule : "corrected" or "paper".
    """
    if rule == "paper":
        return np.where(
            is_handle, _divide_counts(constrained, np.full_like(constrained, constrained[:1])), 0.0
        )
    return np.where(is_handle, 1.0, _divide_counts(constrained, vertices))


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


def _divide_counts(counts: Floats, totals: Floats) -> Floats:
    return np.asarray(np.divide(counts, totals, out=np.zeros(len(counts)), where=totals > 0))
