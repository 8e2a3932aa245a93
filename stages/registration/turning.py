"""Initial poses of an object that moves in front of a static camera, from features and marks."""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.registration.features import Features, recognise
from scanloom.stages.registration.graph import Edge, optimised
from scanloom.stages.registration.looks import Look
from scanloom.stages.registration.marks import Plate, marked_motion, marks_on, moving_marks, plates_of
from scanloom.stages.registration.motion import Motion, agree
from scanloom.stages.registration.still import Backdrop
from scanloom.stages.scans.model.poses import inverted
from scanloom.stages.scans.model.prefetch import read_ahead, workers
from scanloom.stages.scans.model.scan import Frame, Pose

Floats = NDArray[np.float64]
# Motion (target_from_source), and the number of matched points or marks that agree with it.
Link = tuple[Pose, float]

# Minimum number of inliers of a motion; repetitive texture gives fewer by chance.
_SURE_POINTS = 15
# All frame pairs are tried up to this number of frames; otherwise only pairs at most this many frames apart.
_ALL_COUPLES, _NEAR = 16, 2
# Search radius for the support of the object, relative to the radius of the object (80th percentile).
_AROUND = 2.5
# Correspondence distance of the pose graph, relative to the distance of the object.
_REACH_SHARE = 0.03


def first_poses(
    frames: Sequence[Frame],
    features: Mapping[int, Features],
    looks: Mapping[int, Look],
    backdrop: Backdrop,
) -> dict[int, Pose]:
    """Estimate initial poses of a moving object.

    Parameters
    ----------
    frames : frames of one static camera.
    features : features of the moving region, by frame index.
    looks : previews of frames spread over the scan, by frame index.
    backdrop : static background of these frames.

    Returns
    -------
    world_from_camera by frame index, of the frames that motions connect; the world is the object.
    """
    depth = float(np.median([np.median(look.depth[backdrop.first_mask(look)]) for look in looks.values()]))
    couples = couples_of(list(features))
    links = {
        couple: link
        for couple in couples
        if (link := _recognised(features[couple[0]], features[couple[1]], depth)) is not None
    }
    if any(couple not in links for couple in itertools.pairwise(features)):
        links |= marked_links(frames, looks, backdrop, [couple for couple in couples if couple not in links])
    points = np.concatenate([look.points()[backdrop.first_mask(look)] for look in looks.values()])
    return _agreed(_joined(links), links, points, depth)


def _agreed(
    poses: dict[int, Pose], links: Mapping[tuple[int, int], Link], points: Floats, depth: float
) -> dict[int, Pose]:
    """Optimise the poses over all links, and reject links that disagree."""
    centre = points.mean(axis=0)
    # Mean information matrix of one matched point of the object (Choi, Zhou and Koltun 2015).
    cross = np.array(((0, -centre[2], centre[1]), (centre[2], 0, -centre[0]), (-centre[1], centre[0], 0)))
    around = np.eye(3) * 2 / 3 * float(((points - centre) ** 2).sum(axis=1).mean())
    one_point = np.block([[around - cross @ cross, cross], [-cross, np.eye(3)]])
    edges = [
        Edge(source, target, Motion(motion, count * one_point, 1.0, None, int(count)), is_certain=False)
        for (source, target), (motion, count) in links.items()
        if source in poses and target in poses
    ]
    return optimised(poses, edges, _REACH_SHARE * depth)[0] if edges else poses


def couples_of(places: Sequence[int]) -> list[tuple[int, int]]:
    """List frame pairs (earlier, later) that may show the same side of the object."""
    near = len(places) if len(places) <= _ALL_COUPLES else _NEAR
    return [(a, b) for i, a in enumerate(places) for b in places[i + 1 : i + 1 + near]]


def _recognised(source: Features, target: Features, depth: float) -> Link | None:
    """Estimate the motion of the object from matched features.

    Returns the motion with most inliers that is not negligible; None if it has too few.
    """
    moved = [one for one in recognise(source, target) if not agree(one.target_from_source, depth)]
    sure = [one for one in moved if one.points >= _SURE_POINTS]
    return (sure[0].target_from_source, float(sure[0].points)) if sure else None


def marked_links(
    frames: Sequence[Frame],
    looks: Mapping[int, Look],
    backdrop: Backdrop,
    couples: Sequence[tuple[int, int]],
) -> dict[tuple[int, int], Link]:
    """Estimate motions from marks on the plate below the object.

    Returns links by frame pair; empty without a plate.
    """
    around, own = (
        np.concatenate([look.points()[mask(look)] for look in looks.values()])
        for mask in (lambda look: backdrop.around & (look.depth > 0), backdrop.first_mask)
    )
    centre = np.median(own, axis=0)
    reach = _AROUND * float(np.percentile(np.linalg.norm(own - centre, axis=1), 80))
    near = around[np.linalg.norm(around - centre, axis=1) < reach]
    found = (_links_on(plate, frames, couples) for plate in plates_of(near))
    # On a wrong plane the positions of marks are distorted, so that fewer coincide.
    return max(found, key=lambda links: sum(count for _, count in links.values()), default={})


def _links_on(
    plate: Plate, frames: Sequence[Frame], couples: Sequence[tuple[int, int]]
) -> dict[tuple[int, int], Link]:
    threads = workers()
    places = sorted({place for couple in couples for place in couple})
    found = read_ahead(lambda n: marks_on(frames[n], plate), places, threads=threads, ahead=threads)
    marks = moving_marks(dict(zip(places, found, strict=True)), plate)
    motions = ((couple, marked_motion(marks[couple[0]], marks[couple[1]], plate)) for couple in couples)
    return {couple: (one.target_from_source, float(one.marks)) for couple, one in motions if one is not None}


def _joined(links: Mapping[tuple[int, int], Link]) -> dict[int, Pose]:
    """Chain initial poses along the strongest links (maximum spanning tree).

    Only the largest connected component is returned.
    """
    beside: dict[int, list[tuple[int, Pose, float]]] = {}
    for (source, target), (motion, weight) in links.items():
        beside.setdefault(target, []).append((source, motion, weight))
        beside.setdefault(source, []).append((target, inverted(motion), weight))
    pieces = []
    left = set(beside)
    while left:
        piece = dict(_spread(beside, min(left)))
        left -= piece.keys()
        pieces.append(piece)
    return max(pieces, key=len, default={})


def _spread(
    beside: Mapping[int, Sequence[tuple[int, Pose, float]]], first: int
) -> Iterator[tuple[int, Pose]]:
    done: set[int] = set()
    order = itertools.count()
    waiting = [(0.0, next(order), first, np.eye(4))]
    while waiting:
        _, _, place, pose = heapq.heappop(waiting)
        if place in done:
            continue
        done.add(place)
        yield place, pose
        for other, motion, weight in beside[place]:
            if other not in done:
                heapq.heappush(waiting, (-weight, next(order), other, pose @ motion))
