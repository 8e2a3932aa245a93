"""Probes: a limited number of mesh vertices that represent their neighbourhoods.

One vertex represents all vertices in a small cube whose normals have the same dominant direction. A mesh of
any size is reduced to about 80,000 probes, few enough to project into every frame. Meshes are read in
batches; memory grows with the number of occupied cubes only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.depth_view import Floats, Singles
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh, TriangleBatch, find_sorted
from scanloom.stages.surface.raycasting import mask_used_vertices
from scanloom.stages.surface.topology import compute_areas

Ids = NDArray[np.int64]

# Approximate number of probes; minimum and maximum cube size in mesh edges. The size limits take precedence,
# so a building has more probes than a room.
_TARGET_COUNT = 80_000
_CUBE_SIZE_EDGES = 1.5, 6.0
# Number of triangles from measured surface within which a vertex counts as equally well observed.
_RIM_TRIANGLES = 2


@dataclass(frozen=True, eq=False)
class ProbeGrid:
    """Grid of cubes, with six direction classes in each cube.

    Attributes
    ----------
    min_corner : (3,) corner of the grid in mesh coordinates, metres.
    cube_size : side of a cube, metres.
    cube_counts : (3,) number of cubes along each axis.
    """

    min_corner: Floats
    cube_size: float
    cube_counts: Ids

    def compute_keys(self, vertices: Floats, normals: Singles) -> Ids:
        """Return the group key of each vertex (n,).

        The key combines the cube and the direction class of the normal.
        """
        x, y, z = np.floor((vertices - self.min_corner) / self.cube_size).astype(np.int64).T
        # The two sides of a thin sheet get different keys.
        facing = np.abs(normals).argmax(axis=1)
        is_back = np.take_along_axis(normals, facing[:, None], axis=1)[:, 0] < 0
        return np.asarray(
            ((x * self.cube_counts[1] + y) * self.cube_counts[2] + z) * 6 + 2 * facing + is_back
        )


@dataclass(frozen=True, eq=False)
class Probes:
    """Vertices that represent their neighbourhoods.

    Attributes
    ----------
    points, normals : (k, 3) float32; points in metres relative to the origin.
    grid, keys : the grid, and the ascending keys (k,) of the probes.
    rim_indices, rim_probes : ascending global indices of vertices that use another probe than their cube's,
        and those
        probes.
    """

    points: Singles
    normals: Singles
    grid: ProbeGrid
    keys: Ids
    rim_indices: Ids
    rim_probes: Ids

    def find_probes(self, vertices: Floats, normals: Singles, global_indices: Ids) -> Ids:
        """Look up the probe index of each vertex (n,).

        The index is −1 for vertices that no triangle uses.

        Parameters
        ----------
        vertices, normals : (n, 3), in mesh coordinates, metres.
        global_indices : (n,) global vertex indices.
        """
        own = find_sorted(self.keys, self.grid.compute_keys(vertices, normals))
        at_rim = find_sorted(self.rim_indices, global_indices)
        return np.where(at_rim >= 0, self.rim_probes[at_rim], own) if len(self.rim_indices) else own

    def find_batch_probes(self, batch: TriangleBatch) -> Ids:
        """Look up the probe index (n,) of each vertex of a batch.

        The batch must have normals.
        """
        assert batch.normals is not None
        return self.find_probes(batch.mesh.vertices, batch.normals, batch.global_indices)


@dataclass(frozen=True, eq=False)
class ProbeLayout:
    """Areas of the probes, and adjacency between them.

    Attributes
    ----------
    areas : (k,) m².
    links : (l, 2) pairs of adjacent probes (their vertices share an edge), each pair once.
    """

    areas: Floats
    links: Ids


def choose_probes(surface: ChunkedMesh | SingleChunkMesh, origin: Floats, median_edge: float) -> Probes:
    """Choose the probes of a surface.

    Parameters
    ----------
    surface : mesh in batches.
    origin : (3,) origin of the probe coordinates, metres.
    median_edge : median edge length of the mesh, metres.
    """
    low, high = surface.box
    size = float(
        np.clip(
            (surface.area / _TARGET_COUNT) ** 0.5,
            _CUBE_SIZE_EDGES[0] * median_edge,
            _CUBE_SIZE_EDGES[1] * median_edge,
        )
    )
    grid = ProbeGrid(low, size, np.floor((high - low) / size).astype(np.int64) + 1)
    keys, centroids = _compute_group_centroids(surface, grid, origin)
    count = len(keys)
    points, normals = (np.zeros((count, 3), np.float32) for _ in range(2))
    nearest, number = np.full(count, np.inf, np.float32), np.zeros(count, np.int64)
    for piece in surface.iterate_batches(with_normals=True):
        assert piece.normals is not None
        (rows,) = np.nonzero(mask_used_vertices(piece.mesh))
        vertices = piece.mesh.vertices[rows]
        group = np.searchsorted(keys, grid.compute_keys(vertices, piece.normals[rows]))
        # Choose the vertex nearest to the centroid of its group, because vertices near a boundary are
        # measured less often. Single precision makes ties independent of the batch layout.
        squared_distances = ((vertices - origin - centroids[group]) ** 2).sum(axis=1).astype(np.float32)
        first = _find_nearest_rows(group, squared_distances, piece.global_indices[rows])
        group, squared_distances, own = (
            group[first],
            squared_distances[first],
            piece.global_indices[rows[first]],
        )
        is_nearer = (squared_distances < nearest[group]) | (
            (squared_distances == nearest[group]) & (own < number[group])
        )
        group, chosen = group[is_nearer], rows[first][is_nearer]
        nearest[group], number[group] = squared_distances[is_nearer], own[is_nearer]
        points[group], normals[group] = piece.mesh.vertices[chosen] - origin, piece.normals[chosen]
    return Probes(points, normals, grid, keys, np.zeros(0, np.int64), np.zeros(0, np.int64))


def reassign_rims(
    probes: Probes, surface: ChunkedMesh | SingleChunkMesh, frame_counts: NDArray[np.int32]
) -> Probes:
    """Reassign unmeasured vertices at rims to a measured neighbouring probe.

    Fusion extends the surface one or two voxels beyond the measurements. Unmeasured vertices next to measured
    ones are therefore not a separate defect.

    Parameters
    ----------
    probes, surface : the probes, and the mesh they were chosen from.
    frame_counts : (k + 1,) number of frames that measured each probe; the last is 0.
    """
    count = len(probes.keys)
    for _ in range(_RIM_TRIANGLES):
        rims, scores = [probes.rim_indices], [probes.rim_probes]
        for piece in surface.iterate_batches(with_normals=True):
            own = probes.find_batch_probes(piece)
            # Among neighbouring probes, the one measured by most frames is used.
            score = frame_counts[own].astype(np.int64) * count + own
            corners = score[piece.mesh.triangles]
            best = np.broadcast_to(corners.max(axis=1, keepdims=True), corners.shape)
            is_bare = (corners < count) & (best >= count)
            more = _keep_highest_scores(piece.global_indices[piece.mesh.triangles[is_bare]], best[is_bare])
            rims.append(more[0])
            scores.append(more[1])
        numbers, best = _keep_highest_scores(np.concatenate(rims), np.concatenate(scores))
        probes = replace(probes, rim_indices=numbers, rim_probes=best % count)
    return probes


def compute_layout(probes: Probes, surface: ChunkedMesh | SingleChunkMesh) -> ProbeLayout:
    """Compute the area of each probe and the adjacency between probes."""
    count = len(probes.keys)
    total = np.zeros(count)
    links = [np.zeros(0, np.int64)]
    for piece in surface.iterate_batches(with_normals=True):
        triangles = probes.find_batch_probes(piece)[piece.mesh.triangles]
        thirds = np.repeat(compute_areas(piece.mesh.vertices, piece.mesh.triangles) / 3, 3)
        total += np.bincount(triangles.reshape(-1), thirds, minlength=count)
        ends = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]]]), axis=1)
        links.append(np.unique(ends[:, 0] * count + ends[:, 1]))
    first, second = np.divmod(np.unique(np.concatenate(links)), count)
    return ProbeLayout(total, np.stack([first, second], axis=1)[first != second])


def _compute_group_centroids(
    surface: ChunkedMesh | SingleChunkMesh, grid: ProbeGrid, origin: Floats
) -> tuple[Ids, Floats]:
    """Compute the centroid of each group of vertices with equal key.

    Returns
    -------
    keys : (k,) ascending keys of the occupied groups.
    middles : (k, 3) mean of the triangle corners in each group, relative to `origin`, metres.
    """
    keys, sums = [np.zeros(0, np.int64)], [np.zeros((0, 4))]
    for piece in surface.iterate_batches(with_normals=True):
        assert piece.normals is not None
        triangles = piece.mesh.triangles.reshape(-1)
        times = np.bincount(triangles, minlength=len(piece.mesh.vertices))
        (rows,) = np.nonzero(times)
        own, of = np.unique(
            grid.compute_keys(piece.mesh.vertices[rows], piece.normals[rows]), return_inverse=True
        )
        keys.append(own)
        sums.append(_sum_groups(of.reshape(-1), piece.mesh.vertices[rows] - origin, times[rows], len(own)))
    together, of = np.unique(np.concatenate(keys), return_inverse=True)
    every = np.concatenate(sums)
    total = np.stack([np.bincount(of.reshape(-1), column) for column in every.T], axis=1)
    return together, total[:, :3] / total[:, 3:]


def _sum_groups(group: Ids, points: Floats, weights: NDArray[np.int64], count: int) -> Floats:
    columns = [np.bincount(group, axis * weights, minlength=count) for axis in points.T]
    return np.stack([*columns, np.bincount(group, weights, minlength=count)], axis=1)


def _find_nearest_rows(group: Ids, distances: Singles, global_indices: Ids) -> NDArray[np.intp]:
    """Find the row of the nearest vertex in each group.

    Ties go to the lowest vertex index.
    """
    order = np.lexsort((global_indices, distances, group))
    return order[np.flatnonzero(np.diff(group[order], prepend=-1))]


def _keep_highest_scores(indices: Ids, scores: Ids) -> tuple[Ids, Ids]:
    """Return unique ascending indices, each with its highest score."""
    order = np.lexsort((scores, indices))
    last = order[np.flatnonzero(np.diff(indices[order], append=-1))]
    return indices[last], scores[last]
