"""Colours, texture and normals of a solid, from the surface it was made of."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.solids.shell import Shell
from scanloom.stages.surface.cap_fairing import interpolate_values
from scanloom.stages.surface.edges import Ids, label_components
from scanloom.stages.surface.formats.gltf_materials import is_unlit, make_unlit_source
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_closest_weights
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color
from scanloom.stages.surface.texture import Image, Material, Texture, select_rows
from scanloom.stages.surface.vertex_normals import compute_vertex_normals

# Name of the material of added surface.
ADDED_MATERIAL = "added"
# More added vertices take the colour of the nearest vertex: solving for smooth colours takes minutes then.
_MAX_INTERPOLATED = 50_000
# Texels along the sides of the image part of an added triangle: its corners' colours, and one more that makes
# bilinear interpolation linear.
_PART_TEXELS = 2


@dataclass(frozen=True, eq=False)
class TransferredMesh:
    """A solid with attributes, and the source of its vertices.

    Attributes
    ----------
    vertex_source : (n,) vertex of the given mesh at the same position; -1 for new vertices.
    """

    mesh: Mesh
    vertex_source: Ids


def transfer_attributes(shell: Shell, given: Mesh, nearest: Ids | None = None) -> TransferredMesh:
    """Give a solid the colours, texture, normals and parts of the mesh it was made of.

    Added surface continues the colours at its border smoothly.

    Parameters
    ----------
    nearest : (n,) given triangle whose colour a vertex of added surface takes instead; -1 for none.
    """
    is_kept = shell.source >= 0
    weights = np.zeros((len(shell.triangles), 3, 3))
    corners = given.vertices[given.triangles[shell.source[is_kept]]]
    for corner in range(3):
        points = shell.vertices[shell.triangles[is_kept, corner]]
        weights[is_kept, corner] = compute_closest_weights(points, corners)
    vertex_source = _find_vertex_sources(shell, given, is_kept)
    mesh = Mesh(shell.vertices, shell.triangles, part_names=given.part_names, up=given.up)
    if given.part_ids is not None:
        mesh = mesh.with_(part_ids=select_rows(given.part_ids, shell.source, -1).astype(np.int32))
    if has_color(given):
        colors = _compute_colors(shell, given, weights, is_kept, nearest)
        mesh = (
            mesh.with_(colors=_keep_colors(colors, given, vertex_source))
            if given.texture is None
            else mesh.with_(texture=_make_texture(shell, given.texture, weights, colors))
        )
    elif given.texture is not None:
        mesh = mesh.with_(texture=_select_texture(shell, given.texture, weights))
    if given.normals is not None:
        mesh = mesh.with_(normals=compute_vertex_normals(mesh))
    if given.corner_normals is not None:
        normals = np.einsum("mkc,mcx->mkx", weights, select_rows(given.corner_normals, shell.source, 0.0))
        lengths = np.linalg.norm(normals, axis=2, keepdims=True)
        mesh = mesh.with_(corner_normals=normals / np.where(lengths > 0, lengths, 1))
    return TransferredMesh(mesh, vertex_source)


def _find_vertex_sources(shell: Shell, given: Mesh, is_kept: NDArray[np.bool_]) -> Ids:
    found = np.full(len(shell.vertices), -1)
    corners = shell.triangles[is_kept]
    candidates = given.triangles[shell.source[is_kept]]
    for own in range(3):
        for other in range(3):
            same = (shell.vertices[corners[:, own]] == given.vertices[candidates[:, other]]).all(axis=1)
            found[corners[same, own]] = candidates[same, other]
    return found


def _compute_colors(
    shell: Shell, given: Mesh, weights: NDArray[np.float64], is_kept: NDArray[np.bool_], nearest: Ids | None
) -> NDArray[np.float64]:
    """Compute the colour (n, 3) of each vertex, from 0 to 255."""
    values, known = np.zeros((len(shell.vertices), 3)), np.zeros(len(shell.vertices), bool)
    for corner in range(3):
        rows = shell.triangles[is_kept, corner]
        values[rows] = compute_surface_colors(given, shell.source[is_kept], weights[is_kept, corner])
        known[rows] = True
    if nearest is not None:
        (rows,) = np.nonzero((nearest >= 0) & ~known)
        sources = nearest[rows]
        closest = compute_closest_weights(shell.vertices[rows], given.vertices[given.triangles[sources]])
        values[rows] = compute_surface_colors(given, sources, closest)
        known[rows] = True
    if known.all():
        return values
    _set_unreachable(shell, values, known)
    (free,) = np.nonzero(~known)
    if len(free) > _MAX_INTERPOLATED:
        from scipy.spatial import cKDTree

        _, nearest = cKDTree(shell.vertices[known]).query(shell.vertices[free])
        values[free] = values[known][nearest]
    elif len(free):
        values[free] = interpolate_values(shell.vertices, shell.triangles[~is_kept], free, values)
    return values.clip(0, 255)


def _set_unreachable(shell: Shell, values: NDArray[np.float64], known: NDArray[np.bool_]) -> None:
    """Set the colours of components of added surface without a border to the mean colour."""
    tails, heads = shell.triangles[:, :2].reshape(-1), shell.triangles[:, 1:].reshape(-1)
    _, labels = label_components(len(shell.vertices), tails, heads)
    alone = np.bincount(labels, known) == 0
    rows = alone[labels]
    values[rows] = values[known].mean(axis=0) if known.any() else 128.0
    known[rows] = True


def _keep_colors(colors: NDArray[np.float64], given: Mesh, vertex_source: Ids) -> NDArray[np.uint8]:
    rounded: NDArray[np.uint8] = colors.round().astype(np.uint8)
    if given.colors is not None:
        is_old = vertex_source >= 0
        rounded[is_old] = given.colors[vertex_source[is_old]]
    return rounded


def _select_texture(shell: Shell, texture: Texture, weights: NDArray[np.float64]) -> Texture:
    uvs = np.einsum("mkc,mcx->mkx", weights, select_rows(texture.uvs, shell.source, 0.0))
    return texture.select_triangles(shell.source, uvs)


def _make_texture(
    shell: Shell, texture: Texture, weights: NDArray[np.float64], colors: NDArray[np.float64]
) -> Texture:
    """Return the texture, with a material for added triangles whose image has a part for each of them."""
    selected = _select_texture(shell, texture, weights)
    (added,) = np.nonzero(shell.source < 0)
    if len(added) == 0:
        return selected
    a, b, c = colors[shell.triangles[added]].transpose(1, 0, 2)
    parts = np.stack([np.stack([a, b], axis=1), np.stack([c, (b + c - a).clip(0, 255)], axis=1)], axis=1)
    columns = int(np.ceil(np.sqrt(len(added))))
    rows = -(-len(added) // columns)
    pixels = np.zeros((rows * columns, _PART_TEXELS, _PART_TEXELS, 3))
    pixels[: len(added)] = parts
    image = pixels.reshape(rows, columns, _PART_TEXELS, _PART_TEXELS, 3).transpose(0, 2, 1, 3, 4)
    image = image.reshape(rows * _PART_TEXELS, columns * _PART_TEXELS, 3).round().astype(np.uint8)
    row, column = np.divmod(np.arange(len(added)), columns)
    # Texel centres of the corners; v runs upwards.
    centers = np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]])
    x = (column[:, None] * _PART_TEXELS + centers[:, 0]) / image.shape[1]
    y = (row[:, None] * _PART_TEXELS + centers[:, 1]) / image.shape[0]
    uvs, material_ids = selected.uvs.copy(), selected.material_ids.copy()
    uvs[added] = np.stack([x, 1 - y], axis=2)
    material_ids[added] = len(texture.materials)
    kept = make_unlit_source() if any(is_unlit(material) for material in texture.materials) else None
    material = Material(ADDED_MATERIAL, Image(f"{ADDED_MATERIAL}.png", given=image), kept=kept)
    return replace(selected, uvs=uvs, material_ids=material_ids, materials=(*texture.materials, material))
