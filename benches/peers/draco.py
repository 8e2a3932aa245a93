"""Draco, a general mesh coder.

All vertices are kept. Positions are quantised to a grid over the bounding cube.
"""

from __future__ import annotations

import numpy as np

from scanloom.stages.surface.mesh import Mesh

# Compression levels. Which one gives the smaller file depends on the bit depth, so both are tried.
LEVELS = (7, 10)


def encode_draco(mesh: Mesh, bits: int) -> bytes:
    """Encode a mesh without colours; `bits` per coordinate."""
    import DracoPy

    positions, corners = mesh.vertices.astype(np.float32), mesh.triangles.astype(np.uint32)
    files = (
        DracoPy.encode(positions, corners, quantization_bits=bits, compression_level=level)
        for level in LEVELS
    )
    return min(files, key=len)


def decode_draco(data: bytes) -> Mesh:
    """Decode a Draco file."""
    import DracoPy

    found = DracoPy.decode(data)
    return Mesh(np.asarray(found.points, np.float64), np.asarray(found.faces, np.int32))
