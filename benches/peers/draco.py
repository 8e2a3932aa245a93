"""Draco, a general mesh coder: all vertices are kept, positions rounded to a grid over the bounding cube."""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.mesh import Mesh

# One of these gives the smallest file; which of them depends on the bits.
LEVELS = (7, 10)


def encoded(mesh: Mesh, bits: int) -> bytes:
    """Return the smallest file with positions of so many bits a coordinate; colours are left out."""
    import DracoPy

    positions, corners = mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32)
    files = (
        DracoPy.encode(positions, corners, quantization_bits=bits, compression_level=level)
        for level in LEVELS
    )
    return min(files, key=len)


def decoded(data: bytes) -> Mesh:
    """Return the mesh of a file."""
    import DracoPy

    found = DracoPy.decode(data)
    return Mesh(np.asarray(found.points, np.float64), np.asarray(found.faces, np.int32))
