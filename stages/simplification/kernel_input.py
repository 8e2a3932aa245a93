"""Conversion between meshes and kernel arrays, for methods without corner attributes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.progress import Progress
from scanloom.stages.simplification.codes import (
    SIMPLIFY_ATTRIBUTES_LOST,
    SIMPLIFY_TEXTURE_LEFT_OUT,
    USAGE_METHOD_MISMATCH,
)
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import compute_bounding_box
from scanloom.stages.surface.surface_color import get_vertex_attributes

Floats = NDArray[np.float64]
Ids = NDArray[np.int32]
Levels = NDArray[np.uint8]


def create_texture_warning(function_name: str) -> Diagnostic:
    """Create the warning of a function that discards the texture.

    Parameters
    ----------
    function_name : name of the function.
    """
    return SIMPLIFY_TEXTURE_LEFT_OUT.warning(
        "{who} discards the texture",
        remedy="method seams preserves it, and bake creates a new image from the old one.",
        who=function_name,
    )


@dataclass(frozen=True, eq=False)
class KernelInput:
    """Mesh with coordinates relative to its bounding box's centre.

    This avoids cancellation far from the origin.

    Attributes
    ----------
    mesh : the mesh as given.
    origin : (3,) float64, metres, centre of the bounding box.
    vertices : (n, 3) float64, metres, relative to `origin`.
    attributes : (n, 3) uint8, colours; (n, 0) without colours.
    """

    mesh: Mesh
    origin: Floats
    vertices: Floats
    attributes: Levels

    def to_world(self, points: Floats, source: Ids) -> Floats:
        """Transform points (p, 3) back to mesh coordinates.

        Points at the position of their source vertex get its coordinates bit for bit.

        Parameters
        ----------
        points : (p, 3) metres, relative to `origin`.
        source : (p,) source vertex of each point.
        """
        moved = (points != self.vertices.take(source, axis=0)).any(axis=1, keepdims=True)
        return np.where(moved, points + self.origin, self.mesh.vertices.take(source, axis=0))


def make_kernel_input(mesh: Mesh) -> KernelInput:
    """Move the mesh to the centre of its bounding box."""
    if len(mesh.triangles):
        low, high = compute_bounding_box(mesh)
        origin = 0.5 * low + 0.5 * high
    else:
        origin = np.zeros(3)
    return KernelInput(mesh, origin, mesh.vertices - origin, get_vertex_attributes(mesh))


def require_colors(mesh: Mesh, max_color: float | None) -> None:
    """Raise UsageError for a colour bound on a mesh without vertex colours."""
    if max_color is not None and mesh.colors is None:
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "is given, but the mesh has no vertex colours",
            DiagnosticLocation(parameter="max_color"),
            remedy="leave it out.",
        )


@dataclass(frozen=True, eq=False)
class ReducedMesh:
    """Kernel result: a simplified mesh without corner attributes.

    Attributes
    ----------
    vertices : (p, 3) float64, metres.
    attributes : (p, k) float64, colours in levels.
    triangles : (q, 3) int32.
    vertex_source : (p,) int32, input vertex of each vertex.
    merged_into : (n,) int32, vertex that each input vertex was merged into; −1 for none.
    """

    vertices: Floats
    attributes: Floats
    triangles: Ids
    vertex_source: Ids
    merged_into: Ids


def fit_to_input(
    reduced: ReducedMesh, kernel_input: KernelInput, lock: NDArray[np.bool_], threads: int, progress: Progress
) -> tuple[Floats, Floats]:
    """Fit a simplified mesh to its input by least squares.

    Parameters
    ----------
    reduced : simplified mesh.
    kernel_input : the input.
    lock : (n,) bool, input vertices that stay unchanged.
    threads : 0 for one per core.
    progress : called with (steps done, all steps); an exception stops the fit.

    Returns
    -------
    vertices : (p, 3) float64, metres.
    attributes : (p, k) float64.
    """
    vertices, attributes = _kernels.fit(
        reduced.vertices - kernel_input.origin,
        reduced.attributes,
        reduced.triangles,
        lock[reduced.vertex_source],
        kernel_input.vertices,
        kernel_input.attributes,
        kernel_input.mesh.triangles,
        reduced.merged_into,
        threads=threads,
        progress=progress,
    )
    return kernel_input.to_world(vertices, reduced.vertex_source), attributes


def build_result_mesh(
    mesh: Mesh, vertices: Floats, attributes: Floats, triangles: Ids, vertex_source: Ids, function_name: str
) -> Mesh:
    """Build the simplified mesh, and report attributes that it cannot keep.

    Parameters
    ----------
    mesh : the input.
    vertices, attributes, triangles, vertex_source : see `ReducedMesh`.
    function_name : name of the function in diagnostics.
    """
    colors = None
    if mesh.colors is not None:
        # The least-squares colour may be slightly outside the range.
        colors = np.rint(attributes).clip(0, 255).astype(np.uint8)
        if colors.shape[1] == 1:
            colors = np.repeat(colors, 3, axis=1)
    normals = None if mesh.normals is None else mesh.normals[vertex_source]
    lost = {"parts": mesh.part_ids, "corner normals": mesh.corner_normals}
    names = [name for name, value in lost.items() if value is not None]
    if mesh.texture is not None:
        emit(create_texture_warning(function_name))
    if names:
        emit(
            SIMPLIFY_ATTRIBUTES_LOST.warning(
                "{who} discards {names}",
                remedy="method seams preserves them.",
                who=function_name,
                names=", ".join(names),
            )
        )
    return Mesh(
        vertices,
        triangles,
        colors=colors,
        normals=normals,
        diagnostics=mesh.diagnostics,
        up=mesh.up,
        intensity_max=mesh.intensity_max,
    )
