"""Vertices that stand for those around them: as many as can be looked up in each frame, of any mesh.

One vertex stands for all of a small cube that face alike. Meshes come piece by piece; what is kept of them is
as much as there are such cubes.
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

# How many there are, about, and edges of the mesh that a cube is wide, at least and at most: a building has
# more of them than a room.
_POINTS = 80_000
_EDGES = 1.5, 6.0
# Triangles from what was measured that are as well seen.
_RIM = 2


@dataclass(frozen=True, eq=False)
class Cubes:
    """Space in small cubes, each six times: what faces alike is together.

    Attributes
    ----------
    low : (3,) where they begin, metres, in the axes of the mesh.
    size : metres, of their sides.
    count : (3,) how many there are along each axis.
    """

    low: Floats
    size: float
    count: Ids

    def keys(self, vertices: Floats, normals: Singles) -> Ids:
        """Return in which each vertex (n,) is."""
        x, y, z = np.floor((vertices - self.low) / self.size).astype(np.int64).T
        # The two sides of a sheet are two places.
        facing = np.abs(normals).argmax(axis=1)
        is_back = np.take_along_axis(normals, facing[:, None], axis=1)[:, 0] < 0
        return np.asarray(((x * self.count[1] + y) * self.count[2] + z) * 6 + 2 * facing + is_back)


@dataclass(frozen=True, eq=False)
class Probes:
    """Vertices that stand for those around them.

    Attributes
    ----------
    points, normals : (k, 3) float32, metres from the origin on.
    cubes, keys : where they are, ascending.
    rims, instead : vertices, ascending, that another one stands for than that of their cube, and which.
    """

    points: Singles
    normals: Singles
    cubes: Cubes
    keys: Ids
    rims: Ids
    instead: Ids

    def of(self, vertices: Floats, normals: Singles, numbers: Ids) -> Ids:
        """Return which of them stands for each vertex (n,); −1 for what no triangle has.

        Parameters
        ----------
        vertices, normals : (n, 3), metres, in the axes of the mesh.
        numbers : (n,) of the vertices in all of the mesh.
        """
        own = rows_of(self.keys, self.cubes.keys(vertices, normals))
        at_rim = rows_of(self.rims, numbers)
        return np.where(at_rim >= 0, self.instead[at_rim], own) if len(self.rims) else own

    def of_piece(self, piece: Piece) -> Ids:
        """Return which of them stands for each vertex (n,) of a piece that has normals."""
        assert piece.normals is not None
        return self.of(piece.mesh.vertices, piece.normals, piece.numbers)


@dataclass(frozen=True, eq=False)
class Laid:
    """What probes stand for.

    Attributes
    ----------
    areas : (k,) m² of each.
    links : (l, 2) pairs of them whose vertices share an edge, each once.
    """

    areas: Floats
    links: Ids


def probes_of(surface: Piecewise | OnePiece, origin: Floats, edge: float) -> Probes:
    """Choose vertices that stand for those around them.

    Parameters
    ----------
    origin : (3,) metres, what they are counted from.
    edge : metres, the median of the mesh.
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
        # The one that is nearest to the middle of its fellows: at borders less than elsewhere is measured. In
        # single precision those that are as near are so in pieces of any kind.
        away = ((vertices - origin - middles[of]) ** 2).sum(axis=1).astype(np.float32)
        first = _firsts(of, away, piece.numbers[rows])
        of, away, own = of[first], away[first], piece.numbers[rows[first]]
        is_nearer = (away < nearest[of]) | ((away == nearest[of]) & (own < number[of]))
        of, chosen = of[is_nearer], rows[first][is_nearer]
        nearest[of], number[of] = away[is_nearer], own[is_nearer]
        points[of], normals[of] = piece.mesh.vertices[chosen] - origin, piece.normals[chosen]
    return Probes(points, normals, cubes, keys, np.zeros(0, np.int64), np.zeros(0, np.int64))


def with_rims(probes: Probes, surface: Piecewise | OnePiece, frames: NDArray[np.int32]) -> Probes:
    """Return probes of which at rims those beside it stand for a vertex.

    Fusion goes on a voxel or two beyond what was measured; what no frame measured but what is beside it is no
    place of its own.

    Parameters
    ----------
    frames : (k + 1,) how many measured each probe; the last 0.
    """
    count = len(probes.keys)
    for _ in range(_RIM):
        rims, scores = [probes.rims], [probes.instead]
        for piece in surface.pieces(facing=True):
            own = probes.of_piece(piece)
            # What most frames have measured stands for what is beside it.
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
    """Return what probes stand for on a surface."""
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
    """Return the keys (k,) of what is not empty, ascending, and the mean (k, 3) of what corners lie there."""
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
    """Return the rows of the nearest of each, and among those as near of the first."""
    order = np.lexsort((numbers, away, of))
    return order[np.flatnonzero(np.diff(of[order], prepend=-1))]


def _most(numbers: Ids, scores: Ids) -> tuple[Ids, Ids]:
    """Return numbers, each once and ascending, with the highest score that it has."""
    order = np.lexsort((scores, numbers))
    last = order[np.flatnonzero(np.diff(numbers[order], append=-1))]
    return numbers[last], scores[last]
