"""Mass, centre of mass and inertia of closed meshes of uniform density."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MassProperties:
    """Mass properties in the axes of the mesh.

    Attributes
    ----------
    mass_kg : mass.
    center_m : (3,) centre of mass.
    inertia : (3, 3) inertia tensor about the centre of mass, kg m².
    """

    mass_kg: float
    center_m: Floats
    inertia: Floats

    def to_dict(self) -> dict[str, Any]:
        """Return the properties as JSON-compatible values."""
        return {
            "mass_kg": self.mass_kg,
            "center_of_mass_m": self.center_m.tolist(),
            "inertia_kg_m2": self.inertia.tolist(),
        }


def compute_mass_properties(
    surfaces: Iterable[tuple[Floats, NDArray[np.int32]]], density: float
) -> MassProperties:
    """Compute the mass properties of closed surfaces; volume in two of them counts twice.

    Each triangle and the origin span a tetrahedron, whose moments are polynomials of its corners.

    Parameters
    ----------
    surfaces : vertices and triangles of each surface, oriented outwards.
    density : kg/m³.
    """
    corners = np.concatenate([vertices[triangles] for vertices, triangles in surfaces])
    # Near the object, so that moments do not cancel out.
    origin = corners.reshape(-1, 3).mean(axis=0)
    corners = corners - origin
    volumes = np.einsum("nx,nx->n", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    volume = float(volumes.sum())
    sums = corners.sum(axis=1)
    center = (volumes[:, None] * sums).sum(axis=0) / (4 * volume)
    # Second moments of a tetrahedron with one corner at the origin.
    moments = np.einsum("n,nkx,nky->xy", volumes, corners, corners)
    moments = (moments + np.einsum("n,nx,ny->xy", volumes, sums, sums)) / 20
    moments -= volume * np.outer(center, center)
    inertia = np.trace(moments) * np.eye(3) - moments
    return MassProperties(density * volume, center + origin, density * (inertia + inertia.T) / 2)
