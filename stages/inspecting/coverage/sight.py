"""Occlusion test against a mesh that is processed in batches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.inspecting.coverage.views import Floats
from scanloom.stages.surface.piecewise import OnePiece, Piece, Piecewise
from scanloom.stages.surface.raycasting import Surface

# Enlargement of bounding boxes against rounding, relative to the size of the mesh.
_SLACK = 1e-6


class Sight:
    """Ray intersection test with a surface, batch by batch.

    Each batch is tested only with the rays that pass through its bounding box.

    Parameters
    ----------
    surface : mesh that may occlude.
    """

    def __init__(self, surface: Piecewise | OnePiece) -> None:
        self._surface = surface
        self._slack = _SLACK * float(np.linalg.norm(surface.box[1] - surface.box[0]))
        self._last: tuple[Piece, Surface] | None = None

    def is_met(self, origins: Floats, directions: Floats, reaches: Floats) -> NDArray[np.bool_]:
        """Return a mask (k,) of the rays that hit the surface.

        Parameters
        ----------
        origins, directions : (k, 3), metres in mesh coordinates, and unit vectors.
        reaches : (k,) maximum distance of a hit, metres.
        """
        met = np.zeros(len(origins), bool)
        for piece in self._surface.pieces():
            rows = np.flatnonzero(~met & self._may_meet(origins, directions, reaches, piece.box))
            if len(rows):
                hits = self._searched(piece).cast(origins[rows], directions[rows])
                met[rows[hits.rays]] = hits.distances <= reaches[rows[hits.rays]]
        return met

    def _may_meet(
        self, origins: Floats, directions: Floats, reaches: Floats, box: Floats
    ) -> NDArray[np.bool_]:
        """Return a mask (k,) of the rays that pass through a box."""
        near, far = np.zeros(len(origins)), reaches
        low, high = box[0] - self._slack, box[1] + self._slack
        with np.errstate(divide="ignore", invalid="ignore"):
            for axis, (start, way) in enumerate(zip(origins.T, directions.T, strict=True)):
                first, second = (low[axis] - start) / way, (high[axis] - start) / way
                # A ray along a box face gives NaN, which fmin and fmax ignore, so the ray passes.
                near = np.fmax(near, np.fmin(first, second))
                far = np.fmin(far, np.fmax(first, second))
        return np.asarray(near <= far)

    def _searched(self, piece: Piece) -> Surface:
        # A mesh with a single batch is prepared only once.
        if self._last is None or self._last[0] is not piece:
            self._last = piece, Surface(piece.mesh, self._surface.box)
        return self._last[1]
