"""Tangent frames for tangent-space normal maps, as viewers derive them.

The method is MikkTSpace (Mikkelsen 2008, "Simulation of wrinkled surfaces revisited"), the default of glTF.
Tangents are averaged over triangles that share position, normal and texture coordinates, are connected by
edges, and have the same orientation in the image. Weights are angles in the plane of the normal. The
bitangent is the cross product of normal and tangent.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_triangle_normals
from scanloom.stages.surface.welding import find_first_equal_rows
from scanloom.stages.texturing.corner_groups import group_corners

Floats = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class TangentFrames:
    """Tangent frames at the corners of a mesh.

    Attributes
    ----------
    normals, tangents : (m, 3, 3) float32.
    signs : (m,) float32, 1 for counter-clockwise texture coordinates, else −1.
    """

    normals: Floats
    tangents: Floats
    signs: Floats

    def interpolate(self, triangles: NDArray[Any], weights: NDArray[Any]) -> tuple[Floats, Floats, Floats]:
        """Interpolate tangents, bitangents and normals (k, 3) at points of the surface."""
        shares = weights.astype(np.float32)
        normals = interpolate_corners(self.normals, triangles, shares)
        tangents = interpolate_corners(self.tangents, triangles, shares)
        bitangents = np.cross(normals, tangents) * self.signs[triangles][:, None]
        return tangents, np.asarray(bitangents, np.float32), normals


def compute_tangent_frames(mesh: Mesh, uvs: NDArray[np.float64]) -> TangentFrames:
    """Compute the tangent frames of a mesh with texture coordinates (m, 3, 2), v up."""
    normals = get_corner_normals(mesh)
    corners = mesh.vertices[mesh.triangles]
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    (u1, v1), (u2, v2) = ((uvs[:, k] - uvs[:, 0]).T for k in (1, 2))
    area = u1 * v2 - u2 * v1
    signs = np.where(area >= 0, 1.0, -1.0)
    along = _normalize((first * v2[:, None] - second * v1[:, None]) * signs[:, None])
    # Project tangents to the plane of each corner's normal, weighted by the angle of the corner.
    flat = along[:, None] - normals * np.einsum("mx,mkx->mk", along, normals)[..., None]
    weighted = _normalize(flat.reshape(-1, 3)) * _compute_corner_angles(corners, normals).reshape(-1, 1)
    groups = _group_corners(corners, normals, uvs, signs)
    sums = np.stack([np.bincount(groups, weighted[:, axis]) for axis in range(3)], axis=1)
    tangents = _normalize(sums)[groups].reshape(-1, 3, 3)
    return TangentFrames(normals.astype(np.float32), tangents.astype(np.float32), signs.astype(np.float32))


def _group_corners(
    corners: NDArray[np.float64],
    normals: NDArray[np.float64],
    uvs: NDArray[np.float64],
    signs: NDArray[np.float64],
) -> NDArray[np.int32]:
    """Group the corners (3 m,) that share a tangent."""
    # Viewers compare values in single precision, as stored. Positions may exceed its range.
    columns = [*corners.reshape(-1, 3).T]
    columns += [
        column for one in (normals, uvs) for column in one.reshape(-1, one.shape[2]).astype(np.float32).T
    ]
    welded = find_first_equal_rows(columns).reshape(-1, 3)
    return group_corners(welded, lambda one, other: signs[one // 3] == signs[other // 3])


def get_corner_normals(mesh: Mesh) -> NDArray[np.float64]:
    """Return the shading normals (m, 3, 3) of the corners, or face normals."""
    flat = compute_triangle_normals(mesh)[:, None].repeat(3, axis=1)
    if mesh.corner_normals is not None:
        given = mesh.corner_normals
    elif mesh.normals is not None:
        given = mesh.normals[mesh.triangles]
    else:
        return flat
    return np.where((given != 0).any(axis=2, keepdims=True), given, flat)


def decode_normals(
    texels: NDArray[Any],
    frame: tuple[Floats, Floats, Floats],
    scales: NDArray[np.floating[Any]] | float,
) -> Floats:
    """Decode tangent-space normals (k, 3), in levels, to object-space unit normals."""
    tangents, bitangents, normals = frame
    local = texels[:, :3].astype(np.float32) * np.float32(2 / 255) - 1
    local[:, :2] *= np.asarray(scales, np.float32)[..., None] if np.ndim(scales) else np.float32(scales)
    found = local[:, :1] * tangents + local[:, 1:2] * bitangents + local[:, 2:3] * normals
    return _normalize(found)


def encode_normals(directions: Floats, frame: tuple[Floats, Floats, Floats]) -> NDArray[np.uint8]:
    """Encode object-space normals (k, 3) as tangent-space normals, uint8."""
    tangents, bitangents, normals = frame
    # The bitangent is perpendicular to normal and tangent, but these need not be perpendicular to each other.
    y = _dot(directions, bitangents) / np.maximum(_dot(bitangents, bitangents), np.float32(1e-12))
    tt, nn, tn = _dot(tangents, tangents), _dot(normals, normals), _dot(tangents, normals)
    dt, dn = _dot(directions, tangents), _dot(directions, normals)
    determinant = np.maximum(tt * nn - tn * tn, np.float32(1e-12))
    x, z = (dt * nn - dn * tn) / determinant, (dn * tt - dt * tn) / determinant
    # Normal maps cannot represent directions below the surface.
    local = _normalize(np.stack([x, y, np.maximum(z, np.float32(1e-3))], axis=1))
    return np.asarray(np.rint((local + 1) * np.float32(127.5)).clip(0, 255), np.uint8)


def interpolate_corners(values: Floats, triangles: NDArray[Any], shares: Floats) -> Floats:
    """Interpolate corner values (m, 3, 3) at points with barycentric weights (k, 3)."""
    found = values[:, 0].take(triangles, axis=0) * shares[:, :1]
    for k in (1, 2):
        found += values[:, k].take(triangles, axis=0) * shares[:, k : k + 1]
    return found


def _compute_corner_angles(corners: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the angles (m, 3) between the sides at each corner, seen along the normal."""
    angles = np.empty(corners.shape[:2])
    for k in range(3):
        a, b = (
            _normalize(side - normals[:, k] * _dot(side, normals[:, k])[:, None])
            for side in (corners[:, (k + 1) % 3] - corners[:, k], corners[:, (k + 2) % 3] - corners[:, k])
        )
        angles[:, k] = np.arccos(_dot(a, b).clip(-1, 1))
    return angles


def _normalize(vectors: NDArray[Any]) -> NDArray[Any]:
    length = np.sqrt(np.einsum("kx,kx->k", vectors, vectors))[:, None]
    return np.asarray(np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0))


def _dot(a: NDArray[Any], b: NDArray[Any]) -> NDArray[Any]:
    return np.asarray(np.einsum("kx,kx->k", a, b))
