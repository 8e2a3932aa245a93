"""Occlusion test against a mesh that is processed in batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.depth_view import Floats
from scanloom.stages.surface.chunked_mesh import ChunkedMesh, SingleChunkMesh, TriangleBatch
from scanloom.stages.surface.raycasting import RaycastingSurface

# Enlargement of bounding boxes against rounding, relative to the size of the mesh.
_BOX_SLACK_RATIO = 1e-6


class OcclusionTest:
    """Ray intersection test with a surface, batch by batch.

    Each batch is tested only with the rays that pass through its bounding box.

    Parameters
    ----------
    surface : mesh that may occlude.
    """

    def __init__(self, surface: ChunkedMesh | SingleChunkMesh) -> None:
        self._surface = surface
        self._slack = _BOX_SLACK_RATIO * float(np.linalg.norm(surface.box[1] - surface.box[0]))
        self._cached_batch: tuple[TriangleBatch, RaycastingSurface] | None = None

    def is_hit(self, origins: Floats, directions: Floats, max_distances: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the rays that hit the surface.

        Parameters
        ----------
        origins, directions : (k, 3), metres in mesh coordinates, and unit vectors.
        max_distances : (k,) maximum distance of a hit, metres.
        """
        hit = np.zeros(len(origins), bool)
        for piece in self._surface.iterate_batches():
            rows = np.flatnonzero(
                ~hit & self._mask_rays_through_box(origins, directions, max_distances, piece.box)
            )
            if len(rows):
                hits = self._get_batch_surface(piece).cast_rays(origins[rows], directions[rows])
                hit[rows[hits.rays]] = hits.distances <= max_distances[rows[hits.rays]]
        return hit

    def _mask_rays_through_box(
        self, origins: Floats, directions: Floats, max_distances: Floats, box: Floats
    ) -> NDArray[np.bool_]:
        """Return a mask (k,) of the rays that pass through a box."""
        near, far = np.zeros(len(origins)), max_distances
        low, high = box[0] - self._slack, box[1] + self._slack
        with np.errstate(divide="ignore", invalid="ignore"):
            for axis, (start, way) in enumerate(zip(origins.T, directions.T, strict=True)):
                first, second = (low[axis] - start) / way, (high[axis] - start) / way
                # A ray along a box face gives NaN, which fmin and fmax ignore, so the ray passes.
                near = np.fmax(near, np.fmin(first, second))
                far = np.fmin(far, np.fmax(first, second))
        return np.asarray(near <= far)

    def _get_batch_surface(self, piece: TriangleBatch) -> RaycastingSurface:
        # A mesh with a single batch is prepared only once.
        if self._cached_batch is None or self._cached_batch[0] is not piece:
            self._cached_batch = piece, RaycastingSurface(piece.mesh, self._surface.box)
        return self._cached_batch[1]
