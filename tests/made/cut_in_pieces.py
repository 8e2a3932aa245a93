"""Mesh split into chunks, as if it were large."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from scanloom.stages.surface import pieces
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.pieces import Extent, Pieces, Written, write_pieces
from scanloom.stages.surface.piecewise import Piecewise


def cut_in_pieces(path: Path, mesh: Mesh, of: np.ndarray) -> Piecewise:
    """Write a mesh, and return it in pieces.

    Parameters
    ----------
    of : (m,) to which piece each triangle goes.
    """
    order = np.argsort(of, kind="stable")
    triangles, of = mesh.triangles[order], of[order]
    # A vertex is of the first piece that names it.
    used, first, place = np.unique(triangles, return_index=True, return_inverse=True)
    rank = np.empty(len(used), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(used))
    vertices = mesh.vertices[used[np.argsort(rank)]]
    numbers = rank[place.reshape(-1, 3)]
    sizes, written, at = [], [], (0, 0)
    for number in np.unique(of):
        own = numbers[of == number]
        end = max(at[0], int(own.max()) + 1), at[1] + len(own)
        points = vertices[own]
        low, high = points.min(axis=(0, 1)).tolist(), points.max(axis=(0, 1)).tolist()
        sizes.append(Extent((at[0], end[0]), (at[1], end[1]), tuple(low), tuple(high)))
        written.append(Written(vertices[at[0] : end[0]], None, own))
        at = end
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pieces, "MOST_AT_ONCE", 1)
        write_pieces(path, sizes, written, has_colors=False, spacing=1.0)
    return Piecewise(Pieces(path))
