"""Checks that hold for every simplified mesh, independent of the method."""

from __future__ import annotations

from typing import Any

import numpy as np

from scanloom.stages.simplification.methods import BOUND_REQUIREMENT, Method
from scanloom.stages.surface.mesh import Mesh

# Vertices of optimal placement may leave the bounding box by this share of its diagonal.
MAX_FREE_RATIO = 0.01


def compute_diagonal(mesh: Mesh) -> float:
    """Compute the diagonal of the bounding box of the used vertices."""
    used = mesh.vertices[np.unique(mesh.triangles)]
    return float(np.linalg.norm(np.ptp(used, axis=0))) if len(used) else 0.0


def make_parameters(
    method: Method[Any, Any], mesh: Mesh, *, share: float = 0.01, ratio: float = 0.3
) -> dict[str, Any]:
    """Choose arguments with which `simplify` can run a method.

    Parameters
    ----------
    share : shape bound relative to the diagonal, for methods with bounds.
    ratio : of triangles to keep, for all other methods.
    """
    is_bounded = (
        method.requirement == BOUND_REQUIREMENT or not method.capabilities.count or method.name == "jia01"
    )
    goal = {"max_shape": share * compute_diagonal(mesh)} if is_bounded else {"ratio": ratio}
    return {"method": method.name, **goal}


def assert_within_bounds(
    simplified: Mesh, given: Mesh, max_shape: float | None = None, max_free_ratio: float = MAX_FREE_RATIO
) -> None:
    """Check for finite coordinates, and for vertices outside the bounding box of the input.

    Parameters
    ----------
    max_shape : allowed distance in metres, as passed to `simplify`.
    max_free_ratio : allowed distance relative to the diagonal, if there is no `max_shape`.
    """
    assert_finite(simplified)
    if len(simplified.triangles) == 0:
        return
    used = given.vertices[np.unique(given.triangles)]
    low, high = used.min(axis=0), used.max(axis=0)
    margin = max_free_ratio * compute_diagonal(given) if max_shape is None else max_shape
    # Allow for rounding of coordinates.
    margin += 1e-9 * (np.abs(used).max() + compute_diagonal(given))
    outside = np.maximum(low - simplified.vertices, simplified.vertices - high).max(axis=1)
    worst = int(outside.argmax())
    assert outside[worst] <= margin, (
        f"vertex {worst} lies {outside[worst]:g} m outside the bounding box; {margin:g} m are allowed"
    )


def assert_finite(mesh: Mesh) -> None:
    """Check that positions, normals and texture coordinates are finite."""
    fields = {
        "positions": mesh.vertices,
        "normals": mesh.normals,
        "corner normals": mesh.corner_normals,
        "texture coordinates": None if mesh.texture is None else mesh.texture.uvs,
    }
    for name, values in fields.items():
        assert values is None or np.isfinite(values).all(), f"{name} are not finite"
