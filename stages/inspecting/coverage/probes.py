"""Probes: a limited number of mesh vertices that represent their neighbourhoods.

One vertex represents all vertices in a small cube whose normals have the same dominant direction. A mesh of
any size is reduced to about 80,000 probes, few enough to project into every frame. Meshes are read in
batches; memory grows with the number of occupied cubes only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.views import Floats, Singles
from scanloom.stages.surface.piecewise import OnePiece, Piece, Piecewise, rows_of
from scanloom.stages.surface.raycasting import is_used
from scanloom.stages.surface.topology import areas

Ids = NDArray[np.int64]

# Approximate number of probes; minimum and maximum cube size in mesh edges. The size limits take precedence,
# so a building has more probes than a room.
_POINTS = 80_000
_EDGES = 1.5, 6.0
# Number of triangles from measured surface within which a vertex counts as equally well observed.
_RIM = 2


@dataclass(frozen=True, eq=False)
class Cubes:
    """Grid of cubes, with six direction classes in each cube.

    Attributes
    ----------
    low : (3,) corner of the grid in mesh coordinates, metres.
    size : side of a cube, metres.
    count : (3,) number of cubes along each axis.
    """

    low: Floats
    size: float
    count: Ids

    def keys(self, vertices: Floats, normals: Singles) -> Ids:
        """Return the group key of each vertex (n,).

        The key combines the cube and the direction class of the normal.
        """
        x, y, z = np.floor((vertices - self.low) / self.size).astype(np.int64).T
        # The two sides of a thin sheet get different keys.
        facing = np.abs(normals).argmax(axis=1)
        is_back = np.take_along_axis(normals, facing[:, None], axis=1)[:, 0] < 0
        return np.asarray(((x * self.count[1] + y) * self.count[2] + z) * 6 + 2 * facing + is_back)


@dataclass(frozen=True, eq=False)
class Probes:
    """Vertices that represent their neighbourhoods.

    Attributes
    ----------
    points, normals : (k, 3) float32; points in metres relative to the origin.
    cubes, keys : the grid, and the ascending keys (k,) of the probes.
    rims, instead : ascending global indices of vertices that use another probe than their cube's, and those
        probes.
    """

    points: Singles
    normals: Singles
    cubes: Cubes
    keys: Ids
    rims: Ids
    instead: Ids

    def of(self, vertices: Floats, normals: Singles, numbers: Ids) -> Ids:
        """Look up the probe index of each vertex (n,).

        The index is −1 for vertices that no triangle uses.

        Parameters
        ----------
        vertices, normals : (n, 3), in mesh coordinates, metres.
        numbers : (n,) global vertex indices.
        """
        own = rows_of(self.keys, self.cubes.keys(vertices, normals))
        at_rim = rows_of(self.rims, numbers)
        return np.where(at_rim >= 0, self.instead[at_rim], own) if len(self.rims) else own

    def of_piece(self, piece: Piece) -> Ids:
        """Look up the probe index (n,) of each vertex of a batch.

        The batch must have normals.
        """
        assert piece.normals is not None
        return self.of(piece.mesh.vertices, piece.normals, piece.numbers)


@dataclass(frozen=True, eq=False)
class Laid:
    """Areas of the probes, and adjacency between them.

    Attributes
    ----------
    areas : (k,) m².
    links : (l, 2) pairs of adjacent probes (their vertices share an edge), each pair once.
    """

    areas: Floats
    links: Ids


def probes_of(surface: Piecewise | OnePiece, origin: Floats, edge: float) -> Probes:
    """Choose the probes of a surface.

    Parameters
    ----------
    surface : mesh in batches.
    origin : (3,) origin of the probe coordinates, metres.
    edge : median edge length of the mesh, metres.
    """
    low, high = surface.box
    size = float(np.clip((surface.area / _POINTS) ** 0.5, _EDGES[0] * edge, _EDGES[1] * edge))
    cubes = Cubes(low, size, np.floor((high - low) / size).astype(np.int64) + 1)
    keys, middles = _middles(surface, cubes, origin)
    count = len(keys)
    points, normals = (np.zeros((count, 3), np.float32) for _ in range(2))
    nearest, number = np.full(count, np.inf, np.float32), np.zeros(count, np.int64)
    for piece in surface.pieces(facing=True):
        assert piece.normals is not None
        (rows,) = np.nonzero(is_used(piece.mesh))
        vertices = piece.mesh.vertices[rows]
        of = np.searchsorted(keys, cubes.keys(vertices, piece.normals[rows]))
        # Choose the vertex nearest to the centroid of its group, because vertices near a boundary are
        # measured less often. Single precision makes ties independent of the batch layout.
        away = ((vertices - origin - middles[of]) ** 2).sum(axis=1).astype(np.float32)
        first = _firsts(of, away, piece.numbers[rows])
        of, away, own = of[first], away[first], piece.numbers[rows[first]]
        is_nearer = (away < nearest[of]) | ((away == nearest[of]) & (own < number[of]))
        of, chosen = of[is_nearer], rows[first][is_nearer]
        nearest[of], number[of] = away[is_nearer], own[is_nearer]
        points[of], normals[of] = piece.mesh.vertices[chosen] - origin, piece.normals[chosen]
    return Probes(points, normals, cubes, keys, np.zeros(0, np.int64), np.zeros(0, np.int64))


def with_rims(probes: Probes, surface: Piecewise | OnePiece, frames: NDArray[np.int32]) -> Probes:
    """Reassign unmeasured vertices at rims to a measured neighbouring probe.

    Fusion extends the surface one or two voxels beyond the measurements. Unmeasured vertices next to measured
    ones are therefore not a separate defect.

    Parameters
    ----------
    probes, surface : the probes, and the mesh they were chosen from.
    frames : (k + 1,) number of frames that measured each probe; the last is 0.
    """
    count = len(probes.keys)
    for _ in range(_RIM):
        rims, scores = [probes.rims], [probes.instead]
        for piece in surface.pieces(facing=True):
            own = probes.of_piece(piece)
            # Among neighbouring probes, the one measured by most frames is used.
            score = frames[own].astype(np.int64) * count + own
            corners = score[piece.mesh.triangles]
            best = np.broadcast_to(corners.max(axis=1, keepdims=True), corners.shape)
            is_bare = (corners < count) & (best >= count)
            more = _most(piece.numbers[piece.mesh.triangles[is_bare]], best[is_bare])
            rims.append(more[0])
            scores.append(more[1])
        numbers, best = _most(np.concatenate(rims), np.concatenate(scores))
        probes = replace(probes, rims=numbers, instead=best % count)
    return probes


def laid_out(probes: Probes, surface: Piecewise | OnePiece) -> Laid:
    """Compute the area of each probe and the adjacency between probes."""
    count = len(probes.keys)
    total = np.zeros(count)
    links = [np.zeros(0, np.int64)]
    for piece in surface.pieces(facing=True):
        triangles = probes.of_piece(piece)[piece.mesh.triangles]
        thirds = np.repeat(areas(piece.mesh.vertices, piece.mesh.triangles) / 3, 3)
        total += np.bincount(triangles.reshape(-1), thirds, minlength=count)
        ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]]), axis=1)
        links.append(np.unique(ends[:, 0] * count + ends[:, 1]))
    first, second = np.divmod(np.unique(np.concatenate(links)), count)
    return Laid(total, np.stack([first, second], axis=1)[first != second])


def _middles(surface: Piecewise | OnePiece, cubes: Cubes, origin: Floats) -> tuple[Ids, Floats]:
    """Compute the centroid of each group of vertices with equal key.

    Returns
    -------
    keys : (k,) ascending keys of the occupied groups.
    middles : (k, 3) mean of the triangle corners in each group, relative to `origin`, metres.
    """
    keys, sums = [np.zeros(0, np.int64)], [np.zeros((0, 4))]
    for piece in surface.pieces(facing=True):
        assert piece.normals is not None
        triangles = piece.mesh.triangles.reshape(-1)
        times = np.bincount(triangles, minlength=len(piece.mesh.vertices))
        (rows,) = np.nonzero(times)
        own, of = np.unique(cubes.keys(piece.mesh.vertices[rows], piece.normals[rows]), return_inverse=True)
        keys.append(own)
        sums.append(_summed(of.reshape(-1), piece.mesh.vertices[rows] - origin, times[rows], len(own)))
    together, of = np.unique(np.concatenate(keys), return_inverse=True)
    every = np.concatenate(sums)
    total = np.stack([np.bincount(of.reshape(-1), column) for column in every.T], axis=1)
    return together, total[:, :3] / total[:, 3:]


def _summed(of: Ids, points: Floats, times: NDArray[np.int64], count: int) -> Floats:
    columns = [np.bincount(of, axis * times, minlength=count) for axis in points.T]
    return np.stack([*columns, np.bincount(of, times, minlength=count)], axis=1)


def _firsts(of: Ids, away: Singles, numbers: Ids) -> NDArray[np.intp]:
    """Find the row of the nearest vertex in each group.

    Ties go to the lowest vertex index.
    """
    order = np.lexsort((numbers, away, of))
    return order[np.flatnonzero(np.diff(of[order], prepend=-1))]


def _most(numbers: Ids, scores: Ids) -> tuple[Ids, Ids]:
    """Return unique ascending indices, each with its highest score."""
    order = np.lexsort((scores, numbers))
    last = order[np.flatnonzero(np.diff(numbers[order], append=-1))]
    return numbers[last], scores[last]
