"""Weakly observed surface: few, oblique, distant or inconsistent measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.evidence import Evidence
from scanloom.stages.inspecting.coverage.kinds import KINDS, THIN
from scanloom.stages.inspecting.coverage.patches import Patch, cut_up
from scanloom.stages.inspecting.coverage.probes import Laid, Probes
from scanloom.stages.surface.edges import components

_WEIGHTS = np.array([KINDS[kind].weight for kind in THIN])


@dataclass(frozen=True)
class Limits:
    """Thresholds for weakly observed surface.

    Attributes
    ----------
    frames : minimum number of frames.
    cosine : minimum cosine to the normal.
    distance : maximum distance of the nearest frame, metres.
    spread : maximum RMS distance of the measurements from the surface, metres.
    """

    frames: int
    cosine: float
    distance: float
    spread: float


def kinds_at(evidence: Evidence, limits: Limits) -> NDArray[np.int8]:
    """Classify points (n,) by their most important weakness.

    Returns the index in `THIN`; -1 if the point is well observed.
    """
    kinds = np.full(len(evidence.frames), -1, np.int8)
    # Later assignments take precedence; they are in ascending order of importance.
    kinds[evidence.distance > limits.distance] = THIN.index("far")
    kinds[evidence.cosine < limits.cosine] = THIN.index("oblique")
    kinds[evidence.spread > limits.spread] = THIN.index("apart")
    kinds[evidence.frames < limits.frames] = THIN.index("few")
    kinds[evidence.frames == 0] = THIN.index("unmeasured")
    return kinds


def patches_of_thin(
    probes: Probes, laid: Laid, kinds: NDArray[np.int8], size: float, least_area: float
) -> list[Patch]:
    """Group weakly observed probes into connected patches of limited size.

    Parameters
    ----------
    probes, laid : the probes, and their areas and adjacency.
    kinds : (k,) classes of the probes from `kinds_at`.
    size : maximum size of a patch, metres.
    least_area : m²; smaller connected components are dropped.
    """
    thin = kinds >= 0
    ends = laid.links[thin[laid.links].all(axis=1)]
    _, labels = components(len(kinds), ends[:, 0], ends[:, 1])
    total = np.bincount(labels, np.where(thin, laid.areas, 0.0))
    (members,) = np.nonzero(thin & (total[labels] >= least_area) & (laid.areas > 0))
    members = members[np.argsort(labels[members], kind="stable")]
    starts = np.flatnonzero(np.diff(labels[members], prepend=-1))
    points, normals = probes.points.astype(np.float64), probes.normals.astype(np.float64)
    found = []
    for piece in np.split(members, starts[1:]) if len(members) else []:
        for rows in cut_up(points[piece], normals[piece], laid.areas[piece], size):
            own = piece[rows]
            counts = np.bincount(kinds[own], laid.areas[own], minlength=len(THIN)) * _WEIGHTS
            area = float(laid.areas[own].sum())
            kind = THIN[int(counts.argmax())]
            found.append(Patch(kind, points[own], normals[own], laid.areas[own], area, np.zeros((0, 3, 3))))
    return found
