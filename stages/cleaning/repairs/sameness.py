"""Whether corners are the same but for the triangle they are in, so that one can stand for the other."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.surface.edges import Ids
from stages.surface.mesh import Mesh


class Sameness:
    """Compares what a mesh has at corners, and for triangles; both by the numbers they were given with."""

    def __init__(self, mesh: Mesh) -> None:
        texture, normals = mesh.texture, mesh.corner_normals
        self._of_corners: list[NDArray[Any]] = [mesh.triangles.reshape(-1, 1)]
        if texture is not None:
            self._of_corners.append(texture.uvs.reshape(-1, 2))
        if normals is not None:
            self._of_corners.append(normals.reshape(-1, 3))
        self._of_triangles: list[NDArray[Any]] = (
            [] if texture is None else [texture.material_ids, texture.has_uvs()]
        )
        if mesh.part_ids is not None:
            self._of_triangles.append(mesh.part_ids)

    def corners(self, one: Ids, other: Ids) -> NDArray[np.bool_]:
        """Return which corners have the same vertex, texture coordinate and normal as others."""
        found = np.ones(len(one), bool)
        for values in self._of_corners:
            found &= (values[one] == values[other]).all(axis=1)
        return found

    def triangles(self, one: Ids, other: Ids) -> NDArray[np.bool_]:
        """Return which triangles have the same material and part as others."""
        found = np.ones(len(one), bool)
        for values in self._of_triangles:
            found &= values[one] == values[other]
        return found
