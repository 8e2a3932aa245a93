"""Initial poses of an object that moves in front of a static camera, from features and marks."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.registration.features import Features, estimate_motions
from scanloom.stages.registration.frame_preview import FramePreview
from scanloom.stages.registration.motion import Motion, is_negligible
from scanloom.stages.registration.plate_motion import (
    Plate,
    detect_marks,
    detect_plates,
    drop_static_marks,
    estimate_plate_motion,
)
from scanloom.stages.registration.pose_graph import PoseGraphEdge, optimise_poses
from scanloom.stages.registration.static_background import StaticBackground
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.prefetch import get_worker_count, map_ordered
from scanloom.stages.scans.model.scan import Frame, Pose

Floats = NDArray[np.float64]
# Motion (target_from_source), and the number of matched points or marks that agree with it.
MotionLink = tuple[Pose, float]

# Minimum number of inliers of a motion; repetitive texture gives fewer by chance.
_MIN_CERTAIN_POINTS = 15
# All frame pairs are tried up to this number of frames; otherwise only pairs at most this many frames apart.
_MAX_FRAMES_ALL_PAIRS, _MAX_PAIR_DISTANCE = 16, 2
# Search radius for the support of the object, relative to the radius of the object (80th percentile).
_SEARCH_RADIUS_FACTOR = 2.5
# Correspondence distance of the pose graph, relative to the distance of the object.
_REACH_RATIO = 0.03


def estimate_initial_poses(
    frames: Sequence[Frame],
    features: Mapping[int, Features],
    previews: Mapping[int, FramePreview],
    background: StaticBackground,
) -> dict[int, Pose]:
    """Estimate initial poses of a moving object.

    Parameters
    ----------
    frames : frames of one static camera.
    features : features of the moving region, by frame index.
    previews : previews of frames spread over the scan, by frame index.
    background : static background of these frames.

    Returns
    -------
    world_from_camera by frame index, of the frames that motions connect; the world is the object.
    """
    depth = float(
        np.median([np.median(look.depth[background.mask_candidates(look)]) for look in previews.values()])
    )
    couples = list_frame_pairs(list(features))
    links = {
        couple: link
        for couple in couples
        if (link := _estimate_object_motion(features[couple[0]], features[couple[1]], depth)) is not None
    }
    if any(couple not in links for couple in itertools.pairwise(features)):
        links |= link_by_marks(
            frames, previews, background, [couple for couple in couples if couple not in links]
        )
    points = np.concatenate(
        [look.unproject_pixels()[background.mask_candidates(look)] for look in previews.values()]
    )
    return _optimise_links(_chain_strongest_links(links), links, points, depth)


def _optimise_links(
    poses: dict[int, Pose], links: Mapping[tuple[int, int], MotionLink], points: Floats, depth: float
) -> dict[int, Pose]:
    """Optimise the poses over all links, and reject links that disagree."""
    centre = points.mean(axis=0)
    # Mean information matrix of one matched point of the object (Choi, Zhou and Koltun 2015).
    cross = np.array(((0, -centre[2], centre[1]), (centre[2], 0, -centre[0]), (-centre[1], centre[0], 0)))
    around = np.eye(3) * 2 / 3 * float(((points - centre) ** 2).sum(axis=1).mean())
    one_point = np.block([[around - cross @ cross, cross], [-cross, np.eye(3)]])
    edges = [
        PoseGraphEdge(
            source, target, Motion(motion, count * one_point, 1.0, None, int(count)), is_certain=False
        )
        for (source, target), (motion, count) in links.items()
        if source in poses and target in poses
    ]
    return optimise_poses(poses, edges, _REACH_RATIO * depth)[0] if edges else poses


def list_frame_pairs(frame_indices: Sequence[int]) -> list[tuple[int, int]]:
    """List frame pairs (earlier, later) that may show the same side of the object."""
    near = len(frame_indices) if len(frame_indices) <= _MAX_FRAMES_ALL_PAIRS else _MAX_PAIR_DISTANCE
    return [(a, b) for i, a in enumerate(frame_indices) for b in frame_indices[i + 1 : i + 1 + near]]


def _estimate_object_motion(source: Features, target: Features, depth: float) -> MotionLink | None:
    """Estimate the motion of the object from matched features.

    Returns the motion with most inliers that is not negligible; None if it has too few.
    """
    moved = [
        one for one in estimate_motions(source, target) if not is_negligible(one.target_from_source, depth)
    ]
    sure = [one for one in moved if one.inlier_count >= _MIN_CERTAIN_POINTS]
    return (sure[0].target_from_source, float(sure[0].inlier_count)) if sure else None


def link_by_marks(
    frames: Sequence[Frame],
    previews: Mapping[int, FramePreview],
    background: StaticBackground,
    frame_pairs: Sequence[tuple[int, int]],
) -> dict[tuple[int, int], MotionLink]:
    """Estimate motions from marks on the plate below the object.

    Returns links by frame pair; empty without a plate.
    """
    around, own = (
        np.concatenate([look.unproject_pixels()[mask(look)] for look in previews.values()])
        for mask in (lambda look: background.support_region & (look.depth > 0), background.mask_candidates)
    )
    centre = np.median(own, axis=0)
    reach = _SEARCH_RADIUS_FACTOR * float(np.percentile(np.linalg.norm(own - centre, axis=1), 80))
    near = around[np.linalg.norm(around - centre, axis=1) < reach]
    found = (_link_on_plate(plate, frames, frame_pairs) for plate in detect_plates(near))
    # On a wrong plane the positions of marks are distorted, so that fewer coincide.
    return max(found, key=lambda links: sum(count for _, count in links.values()), default={})


def _link_on_plate(
    plate: Plate, frames: Sequence[Frame], frame_pairs: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], MotionLink]:
    threads = get_worker_count()
    places = sorted({place for couple in frame_pairs for place in couple})
    found = map_ordered(
        lambda n: detect_marks(frames[n], plate), places, threads=threads, max_pending=threads
    )
    marks = drop_static_marks(dict(zip(places, found, strict=True)), plate)
    motions = (
        (couple, estimate_plate_motion(marks[couple[0]], marks[couple[1]], plate)) for couple in frame_pairs
    )
    return {
        couple: (one.target_from_source, float(one.mark_count)) for couple, one in motions if one is not None
    }


def _chain_strongest_links(links: Mapping[tuple[int, int], MotionLink]) -> dict[int, Pose]:
    """Chain initial poses along the strongest links (maximum spanning tree).

    Only the largest connected component is returned.
    """
    neighbours: dict[int, list[tuple[int, Pose, float]]] = {}
    for (source, target), (motion, weight) in links.items():
        neighbours.setdefault(target, []).append((source, motion, weight))
        neighbours.setdefault(source, []).append((target, invert_pose(motion), weight))
    pieces = []
    left = set(neighbours)
    while left:
        piece = dict(_traverse_links(neighbours, min(left)))
        left -= piece.keys()
        pieces.append(piece)
    return max(pieces, key=len, default={})


def _traverse_links(
    neighbours: Mapping[int, Sequence[tuple[int, Pose, float]]], start: int
) -> Iterator[tuple[int, Pose]]:
    done: set[int] = set()
    order = itertools.count()
    waiting = [(0.0, next(order), start, np.eye(4))]
    while waiting:
        _, _, place, pose = heapq.heappop(waiting)
        if place in done:
            continue
        done.add(place)
        yield place, pose
        for other, motion, weight in neighbours[place]:
            if other not in done:
                heapq.heappush(waiting, (-weight, next(order), other, pose @ motion))
