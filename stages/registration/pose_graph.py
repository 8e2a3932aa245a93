"""Robust pose graph optimisation that rejects wrong edges (Choi, Zhou and Koltun 2015)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages._open3d import import_open3d
from scanloom.stages.registration.motion import Motion
from scanloom.stages.scans.model.scan import Pose

# Systematic error of any motion in addition to its noise, radians and ratio of the correspondence distance:
# lenses, shutters and clocks never match their models exactly.
_SYSTEMATIC_RAD, _SYSTEMATIC_RATIO = float(np.radians(0.05)), 0.03


@dataclass(frozen=True, eq=False)
class PoseGraphEdge:
    """Edge of the pose graph: a motion between two nodes.

    Attributes
    ----------
    source, target : indices of the nodes.
    motion : relative pose, target_from_source.
    is_certain : the edge is never rejected; True for consecutive key frames.
    """

    source: int
    target: int
    motion: Motion
    is_certain: bool


def find_components(node_count: int, edges: Sequence[PoseGraphEdge]) -> list[list[int]]:
    """Find the connected components of a graph with `node_count` nodes.

    Returns lists of ascending node indices, the largest component first.
    """
    root = list(range(node_count))

    def find_root(i: int) -> int:
        while root[i] != i:
            root[i] = root[root[i]]
            i = root[i]
        return i

    for edge in edges:
        a, b = find_root(edge.source), find_root(edge.target)
        root[max(a, b)] = min(a, b)
    found: dict[int, list[int]] = {}
    for i in range(node_count):
        found.setdefault(find_root(i), []).append(i)
    return sorted(found.values(), key=lambda piece: (-len(piece), piece[0]))


def optimise_poses(
    initial_poses: Mapping[int, Pose], edges: Sequence[PoseGraphEdge], max_correspondence_m: float
) -> tuple[dict[int, Pose], list[bool]]:
    """Optimise the poses of one connected component.

    Parameters
    ----------
    initial_poses : initial world_from_camera by node, metres.
    edges : edges between these nodes.
    max_correspondence_m : maximum distance between corresponding points of two surfaces, metres.

    Returns
    -------
    Poses by node (the first node stays fixed), and for each edge whether it was accepted.
    """
    o3d = import_open3d()
    registration = o3d.pipelines.registration
    numbers = sorted(initial_poses)
    place = {number: i for i, number in enumerate(numbers)}
    graph = registration.PoseGraph()
    for number in numbers:
        graph.nodes.append(registration.PoseGraphNode(np.ascontiguousarray(initial_poses[number])))
    for edge in edges:
        graph.edges.append(
            registration.PoseGraphEdge(
                place[edge.source],
                place[edge.target],
                np.ascontiguousarray(edge.motion.target_from_source),
                np.ascontiguousarray(_add_systematic_error(edge.motion.information, max_correspondence_m)),
                not edge.is_certain,
            )
        )
    if len(numbers) > 1:
        registration.global_optimization(
            graph,
            registration.GlobalOptimizationLevenbergMarquardt(),
            registration.GlobalOptimizationConvergenceCriteria(),
            registration.GlobalOptimizationOption(
                max_correspondence_distance=max_correspondence_m,
                edge_prune_threshold=0.25,
                preference_loop_closure=1.0,
                reference_node=0,
            ),
        )
    poses = {number: np.array(graph.nodes[i].pose) for number, i in place.items()}
    kept = {(edge.source_node_id, edge.target_node_id) for edge in graph.edges}
    return poses, [(place[edge.source], place[edge.target]) in kept for edge in edges]


def _add_systematic_error(
    information: NDArray[np.float64], max_correspondence_m: float
) -> NDArray[np.float64]:
    """Reduce an information matrix (6, 6) by the systematic error of motions."""
    off = np.diag([_SYSTEMATIC_RAD**2] * 3 + [(_SYSTEMATIC_RATIO * max_correspondence_m) ** 2] * 3)
    known = np.linalg.solve(np.eye(6) + information @ off, information)
    return np.asarray(0.5 * (known + known.T))
