"""Planes that a hole cuts: which rim vertices are on which plane, and the creases where planes meet."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from scanloom.stages.refinement.cap_remeshing import Floats
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
    start, end : positions in the loop of its first and last rim vertex.
    crease : (c, 3) points of the crease from `end` back to `start`, without these; metres.
    """

    plane: int
    start: int
    end: int
    crease: Floats


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
) -> list[Section]:
    """Divide a cap into the planes around it: one plane, or two that meet in a straight crease.

    Parameters
    ----------
    rim : (n, 3) vertices of the loop, metres.
    plane_ids : (n,) plane of each vertex, −1 for none.
    tolerances : (n,) maximum distance of each vertex from its plane, metres.
    edge_length : distance of vertices on the crease, metres.

    Returns
    -------
    Empty if the rim is not on one or two planes.
    """
    candidates = np.unique(plane_ids[plane_ids >= 0])
    if not len(candidates) or (plane_ids >= 0).mean() < _MIN_LABELLED_RATIO:
        return []
    heights = np.abs(rim @ planes.normals[candidates].T - planes.offsets[candidates])
    is_near = heights <= tolerances[:, None]
    for number in np.argsort(-is_near.sum(axis=0), kind="stable"):
        if is_near[:, number].all():
            return [Section(int(candidates[number]), 0, len(rim) - 1, np.empty((0, 3)))]
    if not is_near.any(axis=1).all():
        return []
    # A vertex near several planes is on their crease, and belongs to any of them.
    clear = np.flatnonzero(is_near.sum(axis=1) == 1)
    if len(clear) < 2:
        return []
    labels = candidates[is_near[clear].argmax(axis=1)]
    changes = np.flatnonzero(labels != np.roll(labels, -1))
    if len(changes) != 2:
        return []
    pair = labels[changes]
    line = _intersect_planes(planes, pair)
    if line is None:
        return []
    ends = []
    for change in changes:
        last, first = int(clear[change]), int(clear[(change + 1) % len(clear)])
        between = np.arange(last, first + 1 + (len(rim) if first < last else 0)) % len(rim)
        distances = _measure_distances(rim[between], line)
        if distances.min() > _MAX_CREASE_EDGES * edge_length:
            return []
        ends.append(int(between[distances.argmin()]))
    first, second = ends
    if first == second:
        return []
    crease = _divide_line(rim[first], rim[second], line, edge_length)
    # After the first change of planes, the rim is on the second plane.
    return [Section(int(pair[1]), first, second, crease[::-1]), Section(int(pair[0]), second, first, crease)]


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
