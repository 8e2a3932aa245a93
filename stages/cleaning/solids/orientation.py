"""Orientation of closed components: outwards, or inwards around a cavity of another component."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.solids.level_set import WindingNumbers
from scanloom.stages.surface.edges import Ids
from scanloom.stages.surface.mesh import Mesh


def find_inside_out(mesh: Mesh, component: Ids, volumes: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Find closed components that face inwards without bounding a cavity of another component.

    Parameters
    ----------
    component : (m,) component of each triangle.
    volumes : (k,) signed volume of each component, m³; 0 for open components, which are ignored.

    Returns
    -------
    mask (k,)
    """
    found = np.asarray(volumes < 0)
    outer = volumes[component] > 0
    if not found.any() or not outer.any():
        return found
    surface = WindingNumbers(Mesh(mesh.vertices, mesh.triangles[outer]))
    first = np.zeros(len(volumes), np.int64)
    first[component[::-1]] = np.arange(len(component))[::-1]
    probes = mesh.vertices[mesh.triangles[first[found]]].mean(axis=1)
    found[found] = ~surface.is_inside(probes)
    return found
