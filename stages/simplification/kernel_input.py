"""A mesh as the kernels of `simplify` take it, and their results as meshes again."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.progress import Progress
from scanloom.stages.simplification.codes import (
    SIMPLIFY_ATTRIBUTES_LOST,
    SIMPLIFY_TEXTURE_LEFT_OUT,
    USAGE_METHOD_MISMATCH,
)
from scanloom.stages.surface.color import attributes_of
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import bounding_box

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]
Levels = NDArray[np.uint8]


def texture_left_out(who: str) -> Diagnostic:
    """Return the warning of a function that leaves out the texture."""
    return SIMPLIFY_TEXTURE_LEFT_OUT.warning(
        "{who} left out: texture",
        remedy="method seams carries it, and bake makes a new image from the old one.",
        who=who,
    )


@dataclass(frozen=True, eq=False)
class KernelInput:
    """A mesh about the middle of its bounding box: far from the origin, products of coordinates lose digits.

    Attributes
    ----------
    mesh : as it was given.
    origin : (3,) float64, metres, the middle of its bounding box.
    vertices : (n, 3) float64, metres, from there.
    attributes : (n, 3) uint8, colours; (n, 0) without colours.
    """

    mesh: Mesh
    origin: Floats
    vertices: Floats
    attributes: Levels

    def placed_back(self, points: Floats, source: Ids) -> Floats:
        """Return points (p, 3) from `origin` in the mesh's own coordinates.

        A point that is still where its `source` vertex (p,) was gets that vertex's coordinates to the bit.
        """
        moved = (points != self.vertices.take(source, axis=0)).any(axis=1, keepdims=True)
        return np.where(moved, points + self.origin, self.mesh.vertices.take(source, axis=0))


def kernel_input(mesh: Mesh) -> KernelInput:
    """Return the mesh about the middle of its bounding box."""
    if len(mesh.triangles):
        low, high = bounding_box(mesh)
        origin = 0.5 * low + 0.5 * high
    else:
        origin = np.zeros(3)
    return KernelInput(mesh, origin, mesh.vertices - origin, attributes_of(mesh))


def require_colors(mesh: Mesh, max_color: float | None) -> None:
    """Raise UsageError for a bound on the colours of a mesh that has none."""
    if max_color is not None and mesh.colors is None:
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "is given, but the mesh has no vertex colours",
            Where(parameter="max_color"),
            remedy="leave it out.",
        )


@dataclass(frozen=True, eq=False)
class Light:
    """What is left of a mesh.

    Attributes
    ----------
    vertices : (p, 3) float64, metres.
    attributes : (p, k) float64.
    triangles : (q, 3) int32.
    vertex_source : (p,) int32, the vertex of the input that each one was.
    became : (n,) int32, the vertex here that each vertex of the input became part of; −1 for none.
    """

    vertices: Floats
    attributes: Floats
    triangles: Ids
    vertex_source: Ids
    became: Ids


def fitted(
    light: Light, given: KernelInput, lock: NDArray[np.bool_], threads: int, progress: Progress
) -> tuple[Floats, Floats]:
    """Return vertices and attributes of `light`, moved to fit the mesh it was made from by least squares.

    Parameters
    ----------
    lock : (n,) bool, vertices of the input that stay as they are.
    threads : 0 for one a core.
    progress : raising from it stops the work.
    """
    vertices, attributes = _kernels.fit(
        light.vertices - given.origin,
        light.attributes,
        light.triangles,
        lock[light.vertex_source],
        given.vertices,
        given.attributes,
        given.mesh.triangles,
        light.became,
        threads=threads,
        progress=progress,
    )
    return given.placed_back(vertices, light.vertex_source), attributes


def as_result(
    mesh: Mesh, vertices: Floats, attributes: Floats, triangles: Ids, vertex_source: Ids, who: str
) -> Mesh:
    """Return what `mesh` has become, with what can follow of its attributes.

    Attributes that are lost are reported.

    Parameters
    ----------
    who : name of the function in diagnostics.
    """
    colors = None
    if mesh.colors is not None:
        # The best colour at a place can lie outside the range of colours a little.
        colors = np.rint(attributes).clip(0, 255).astype(np.uint8)
    normals = None if mesh.normals is None else mesh.normals[vertex_source]
    lost = {"parts": mesh.part_ids, "normals of corners": mesh.corner_normals}
    names = [name for name, value in lost.items() if value is not None]
    if mesh.texture is not None:
        emit(texture_left_out(who))
    if names:
        emit(
            SIMPLIFY_ATTRIBUTES_LOST.warning(
                "{who} left out: {names}",
                remedy="method seams carries them.",
                who=who,
                names=", ".join(names),
            )
        )
    return Mesh(vertices, triangles, colors=colors, normals=normals, diagnostics=mesh.diagnostics, up=mesh.up)
