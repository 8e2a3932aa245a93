"""Planes that a hole cuts: which rim vertices are on which plane, and the creases where planes meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from scanloom.stages.surface.cap_remeshing import Floats
from scanloom.stages.surface.edges import Ids

# Minimum part of the rim vertices that `refine` has put on the planes of the cap.
_MIN_LABELLED_RATIO = 0.5
# Minimum sine of the angle between two planes that meet in a crease (15°), as for creases of the mesh.
_MIN_SINE = 0.26
# Maximum distance of a crease from the rim vertices where it starts and ends, in edge lengths.
_MAX_CREASE_EDGES = 1.5
# Vertices farther from their plane than this multiple of the RMS distance are ignored by the second fit.
_MAX_OUTLIER_RATIO = 3.0


@dataclass(frozen=True, eq=False)
class Planes:
    """Planes of a refined mesh.

    Attributes
    ----------
    normals : (k, 3) unit normals.
    offsets : (k,) dot product of the normal and the points of each plane, metres.
    """

    normals: Floats
    offsets: Floats

    def measure_heights(self, points: Floats, chosen: Ids) -> Floats:
        """Return the signed distance of each point (n, 3) from its plane."""
        return np.asarray((points * self.normals[chosen]).sum(axis=1) - self.offsets[chosen])

    def project(self, points: Floats, chosen: Ids) -> Floats:
        """Project each point (n, 3) onto its plane."""
        return points - self.measure_heights(points, chosen)[:, None] * self.normals[chosen]


class Section(NamedTuple):
    """Part of a cap that continues one plane.

    Attributes
    ----------
    plane : its plane; −1 for a cap that is not planar.
    outline : (k,) vertices around the section: positions in the loop, then, counted from the length of the
        loop, positions in `DividedCap.points`.
    """

    plane: int
    outline: Ids


class DividedCap(NamedTuple):
    """Cap divided by the creases of the planes around it.

    Attributes
    ----------
    sections : one per plane.
    creases : (k,) vertices of each crease with both ends, numbered as in `Section.outline`.
    points : (c, 3) points of the creases inside of the hole, metres.
    point_planes : (c,) plane of each point.
    """

    sections: list[Section]
    creases: list[Ids]
    points: Floats
    point_planes: Ids


def fit_planes(vertices: Floats, plane_ids: Ids, plane_count: int) -> Planes:
    """Fit the planes of a mesh by least squares, from the vertices labelled with them."""
    (members,) = np.nonzero(plane_ids >= 0)
    for _ in range(2):
        points, labels = vertices[members], plane_ids[members]
        counts = np.maximum(np.bincount(labels, minlength=plane_count), 1)
        centres = _sum_by(labels, points, plane_count) / counts[:, None]
        offsets = points - centres[labels]
        # One product at a time: all nine take more memory than the mesh.
        products = [np.bincount(labels, a * b, plane_count) for a in offsets.T for b in offsets.T]
        _, axes = np.linalg.eigh(np.stack(products, axis=1).reshape(-1, 3, 3))
        normals = axes[:, :, 0]
        planes = Planes(normals, (normals * centres).sum(axis=1))
        heights = planes.measure_heights(points, labels)
        rms = np.sqrt(np.bincount(labels, heights**2, plane_count) / counts)
        members = members[np.abs(heights) <= _MAX_OUTLIER_RATIO * rms[labels] + np.finfo(np.float64).eps]
    return planes


def _sum_by(labels: Ids, values: Floats, count: int) -> Floats:
    return np.stack([np.bincount(labels, column, count) for column in values.T], axis=1)


def divide_cap(
    rim: Floats, plane_ids: Ids, tolerances: Floats, planes: Planes, edge_length: float
) -> DividedCap | None:
    """Divide a cap into the planes around it.

    These are one plane, two planes that meet in a straight crease, or three planes that meet in a corner.

    Parameters
    ----------
    rim : (n, 3) vertices of the loop, metres.
    plane_ids : (n,) plane of each vertex, −1 for none.
    tolerances : (n,) maximum distance of each vertex from its plane, metres.
    edge_length : distance of vertices on the creases, metres.

    Returns
    -------
    None if the rim is not on such planes.
    """
    candidates = np.unique(plane_ids[plane_ids >= 0])
    if not len(candidates) or (plane_ids >= 0).mean() < _MIN_LABELLED_RATIO:
        return None
    heights = np.abs(rim @ planes.normals[candidates].T - planes.offsets[candidates])
    is_near = heights <= tolerances[:, None]
    for number in np.argsort(-is_near.sum(axis=0), kind="stable"):
        if is_near[:, number].all():
            return keep_whole(len(rim), int(candidates[number]))
    if not is_near.any(axis=1).all():
        return None
    # A vertex near several planes is on their crease, and belongs to any of them.
    clear = np.flatnonzero(is_near.sum(axis=1) == 1)
    labels = candidates[is_near[clear].argmax(axis=1)]
    changes = np.flatnonzero(labels != np.roll(labels, -1))
    if len(changes) not in (2, 3):
        return None
    around = labels[changes]
    lines, ends = [], []
    for change, pair in zip(changes, np.stack([around, np.roll(around, -1)], axis=1), strict=True):
        line = _intersect_planes(planes, pair)
        if line is None:
            return None
        last, first = int(clear[change]), int(clear[(change + 1) % len(clear)])
        between = np.arange(last, first + 1 + (len(rim) if first < last else 0)) % len(rim)
        distances = _measure_distances(rim[between], line)
        if distances.min() > _MAX_CREASE_EDGES * edge_length:
            return None
        lines.append(line)
        ends.append(int(between[distances.argmin()]))
    if len(set(ends)) < len(ends):
        return None
    if len(ends) == 2:
        return _divide_at_crease(rim, around, ends, lines[0], edge_length)
    return _divide_at_corner(rim, around, ends, lines, planes, edge_length)


def keep_whole(rim_length: int, plane: int = -1) -> DividedCap:
    """Return a cap of a single section."""
    return DividedCap([Section(plane, np.arange(rim_length))], [], np.empty((0, 3)), np.empty(0, np.int64))


def _divide_at_crease(
    rim: Floats, around: Ids, ends: list[int], line: tuple[Floats, Floats], edge_length: float
) -> DividedCap:
    """Divide a cap into two planes.

    Parameters
    ----------
    around : (2,) planes along the rim; the rim is on the second one from the first of `ends` on.
    ends : positions in the rim where the crease ends.
    """
    first, second = ends
    points = _divide_line(rim[first], rim[second], line, edge_length)
    crease = np.concatenate([[first], len(rim) + np.arange(len(points)), [second]])
    sections = [
        Section(int(around[1]), np.concatenate([_walk(rim, first, second), crease[-2:0:-1]])),
        Section(int(around[0]), np.concatenate([_walk(rim, second, first), crease[1:-1]])),
    ]
    return DividedCap(sections, [crease], points, np.full(len(points), around[1]))


def _divide_at_corner(
    rim: Floats,
    around: Ids,
    ends: list[int],
    lines: list[tuple[Floats, Floats]],
    planes: Planes,
    edge_length: float,
) -> DividedCap | None:
    """Divide a cap into three planes that meet in a point; None if the point is far from the hole.

    Parameters
    ----------
    around : (3,) planes along the rim. From `ends[k]` on, the rim is on plane k + 1.
    ends : positions in the rim where the creases start.
    lines : creases of plane k and k + 1.
    """
    normals = planes.normals[around]
    if abs(np.linalg.det(normals)) < _MIN_SINE**2:
        return None
    corner = np.asarray(np.linalg.solve(normals, planes.offsets[around]), np.float64)
    centre = rim.mean(axis=0)
    if np.linalg.norm(corner - centre) > np.linalg.norm(rim - centre, axis=1).max():
        return None
    points, creases, count = [corner[None]], [], 1
    for start, line in zip(ends, lines, strict=True):
        one = _divide_line(rim[start], corner, line, edge_length)
        creases.append(np.concatenate([[start], len(rim) + count + np.arange(len(one)), [len(rim)]]))
        points.append(one)
        count += len(one)
    sections = []
    for k in range(3):
        following = (k + 1) % 3
        walk = _walk(rim, ends[k], ends[following])
        outline = np.concatenate([walk, creases[following][1:], creases[k][-2:0:-1]])
        sections.append(Section(int(around[following]), outline))
    labels = np.repeat(np.concatenate([around[:1], around]), [len(one) for one in points])
    return DividedCap(sections, creases, np.concatenate(points), labels)


def _walk(rim: Floats, start: int, end: int) -> Ids:
    """Return the positions in a rim from one to another, with both."""
    return np.arange(start, end + 1 + (len(rim) if end < start else 0)) % len(rim)


def _intersect_planes(planes: Planes, pair: Ids) -> tuple[Floats, Floats] | None:
    """Return a point and the unit direction of the line where two planes meet; None if nearly parallel."""
    normals = planes.normals[pair]
    direction = np.cross(normals[0], normals[1])
    sine = float(np.linalg.norm(direction))
    if sine < _MIN_SINE:
        return None
    point = np.linalg.lstsq(normals, planes.offsets[pair], rcond=None)[0]
    return np.asarray(point, np.float64), np.asarray(direction / sine, np.float64)


def _measure_distances(points: Floats, line: tuple[Floats, Floats]) -> Floats:
    offsets = points - line[0]
    return np.asarray(np.linalg.norm(offsets - np.outer(offsets @ line[1], line[1]), axis=1))


def _divide_line(start: Floats, end: Floats, line: tuple[Floats, Floats], edge_length: float) -> Floats:
    """Return points of a line between the projections of two positions, without these."""
    first, last = (float((one - line[0]) @ line[1]) for one in (start, end))
    count = max(1, round(abs(last - first) / edge_length))
    shares = np.arange(1, count) / count
    return np.asarray(line[0] + (first + shares * (last - first))[:, None] * line[1])
