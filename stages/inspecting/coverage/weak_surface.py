"""Weakly observed surface: few, oblique, distant or inconsistent measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.defect_kinds import DEFECT_KINDS, WEAK_KINDS
from scanloom.stages.inspecting.coverage.defect_patches import DefectPatch, split_patch
from scanloom.stages.inspecting.coverage.measurement_evidence import Evidence
from scanloom.stages.inspecting.coverage.probes import ProbeLayout, Probes
from scanloom.stages.surface.edges import label_components

_KIND_WEIGHTS = np.array([DEFECT_KINDS[kind].weight for kind in WEAK_KINDS])


@dataclass(frozen=True)
class EvidenceLimits:
    """Thresholds for weakly observed surface.

    Attributes
    ----------
    min_frames : minimum number of frames.
    min_cosine : minimum cosine to the normal.
    max_distance : maximum distance of the nearest frame, metres.
    max_spread : maximum RMS distance of the measurements from the surface, metres.
    """

    min_frames: int
    min_cosine: float
    max_distance: float
    max_spread: float


def classify_evidence(evidence: Evidence, limits: EvidenceLimits) -> NDArray[np.int8]:
    """Classify points (n,) by their most important weakness.

    Returns the index in `WEAK_KINDS`; -1 if the point is well observed.
    """
    kinds = np.full(len(evidence.frame_counts), -1, np.int8)
    # Later assignments take precedence; they are in ascending order of importance.
    kinds[evidence.min_distance > limits.max_distance] = WEAK_KINDS.index("far")
    kinds[evidence.max_cosine < limits.min_cosine] = WEAK_KINDS.index("oblique")
    kinds[evidence.rms_height > limits.max_spread] = WEAK_KINDS.index("apart")
    kinds[evidence.frame_counts < limits.min_frames] = WEAK_KINDS.index("few")
    kinds[evidence.frame_counts == 0] = WEAK_KINDS.index("unmeasured")
    return kinds


def find_weak_patches(
    probes: Probes, layout: ProbeLayout, kinds: NDArray[np.int8], max_patch_size: float, min_area: float
) -> list[DefectPatch]:
    """Group weakly observed probes into connected patches of limited size.

    Parameters
    ----------
    probes, layout : the probes, and their areas and adjacency.
    kinds : (k,) classes of the probes from `classify_evidence`.
    max_patch_size : maximum size of a patch, metres.
    min_area : m²; smaller connected components are dropped.
    """
    is_weak = kinds >= 0
    ends = layout.links[is_weak[layout.links].all(axis=1)]
    _, labels = label_components(len(kinds), ends[:, 0], ends[:, 1])
    total = np.bincount(labels, np.where(is_weak, layout.areas, 0.0))
    (members,) = np.nonzero(is_weak & (total[labels] >= min_area) & (layout.areas > 0))
    members = members[np.argsort(labels[members], kind="stable")]
    starts = np.flatnonzero(np.diff(labels[members], prepend=-1))
    points, normals = probes.points.astype(np.float64), probes.normals.astype(np.float64)
    found = []
    for component in np.split(members, starts[1:]) if len(members) else []:
        for rows in split_patch(
            points[component], normals[component], layout.areas[component], max_patch_size
        ):
            rows_in_patch = component[rows]
            counts = (
                np.bincount(kinds[rows_in_patch], layout.areas[rows_in_patch], minlength=len(WEAK_KINDS))
                * _KIND_WEIGHTS
            )
            area = float(layout.areas[rows_in_patch].sum())
            kind = WEAK_KINDS[int(counts.argmax())]
            found.append(
                DefectPatch(
                    kind,
                    points[rows_in_patch],
                    normals[rows_in_patch],
                    layout.areas[rows_in_patch],
                    area,
                    np.zeros((0, 3, 3)),
                )
            )
    return found
