"""Record of the collapses of a simplification, for restoring any intermediate mesh.

The record is a minimal progressive mesh (Hoppe, "Progressive meshes", 1996): the input, and per collapse the
removed vertex, the surviving vertex and its new position. Any number of collapses is replayed at once, by
mapping every vertex to the one it has been merged into.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import MeshError, UsageError
from scanloom.stages.params import resolve
from scanloom.stages.printing import format_by_fields, render_table
from scanloom.stages.progress import ignore_progress
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID
from scanloom.stages.simplification.corner_attributes import SimplifiedCorners
from scanloom.stages.simplification.kernel_input import (
    Floats,
    Ids,
    ReducedMesh,
    build_result_mesh,
    fit_to_input,
    make_kernel_input,
)
from scanloom.stages.simplification.records.archive import Arrays, write_arrays
from scanloom.stages.simplification.records.collapse_steps import (
    CollapseSteps,
    ReplayedMesh,
    ReplayParams,
    ReplayState,
)
from scanloom.stages.simplification.records.mesh_serialization import serialize_mesh
from scanloom.stages.simplification.records.wedge_serialization import serialize_wedges
from scanloom.stages.simplification.records.wedges import Wedges
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.surface_color import get_vertex_attributes

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ReplayKeywords


FORMAT_VERSION = 2


@dataclass(frozen=True, eq=False)
class CollapseRecord:
    """All collapses of one simplification.

    Attributes
    ----------
    mesh : mesh before the first collapse: the input, after edge splits by method `jia01`. Without wedges, it
        lacks corner attributes, which then cannot be replayed.
    removed, survivor : (m,) int32, removed vertex of each collapse, and the vertex it was merged into.
        Indices refer to `mesh`, or to the vertices of `wedges`.
    path : (m, 3 + k) float64, new position of the survivor in metres, and its colour in 8-bit levels, if any.
        With wedges (m, 3), relative to the origin of their attributes.
    lock : (n,) bool, vertices of `mesh` that stay unchanged.
    vertex_source, triangle_source : (n,) and (t,) int32, input vertex and triangle of each one of `mesh`;
        None if `mesh` has the indices of the input.
    wedges : changes of corner attributes; None without corner attributes.
    """

    __repr__ = format_by_fields
    _repr_html_ = render_table

    mesh: Mesh
    removed: Ids
    survivor: Ids
    path: Floats
    lock: NDArray[np.bool_]
    vertex_source: Ids | None = None
    triangle_source: Ids | None = None
    wedges: Wedges | None = None

    @cached_property
    def _steps(self) -> CollapseSteps:
        if self.wedges is None:
            return CollapseSteps(self.mesh.triangles, len(self.mesh.vertices), self.removed, self.survivor)
        return CollapseSteps(self.wedges.triangles, self.wedges.vertex_count, self.removed, self.survivor)

    def count_triangles_after(self, collapses: int) -> int:
        """Return the number of triangles after a number of collapses."""
        return self._steps.count_triangles_after(collapses)

    def replay(self, params: ReplayParams | None = None, **changes: Unpack[ReplayKeywords]) -> ReplayedMesh:
        """Restore the mesh at a triangle count or number of collapses.

        The topology of the input is preserved at every step. The last step is bit-identical to the result of
        `simplify`, if both are fitted or neither is.

        Parameters
        ----------
        params : ReplayParams; single fields can be given as keywords instead.

        Returns
        -------
        ReplayedMesh

        Raises
        ------
        UsageError
            If the record ends before the requested step, or for `fit` with wedges, whose fit needs the
            complete simplification.
        MeshError
            If the mesh of a manipulated record cannot be fitted.
        """
        params = resolve(ReplayParams, params, dict(changes))
        if self.wedges is None:
            with collecting() as diagnostics:
                found = self._replay_vertices(
                    self._steps.compute_state(self._steps.compute_collapse_count(params)), fit=params.fit
                )
            return replace(found, diagnostics=tuple(diagnostics))
        if params.fit:
            raise UsageError(
                SIMPLIFY_RECORD_INVALID,
                "a record of method seams cannot be fitted to the input",
                remedy="run simplify with that triangle count instead.",
            )
        return self._replay_wedges(
            self.wedges, self._steps.compute_state(self._steps.compute_collapse_count(params))
        )

    def _replay_vertices(self, state: ReplayState, *, fit: bool) -> ReplayedMesh:
        positions = self._move_survivors(
            np.concatenate([self.mesh.vertices, get_vertex_attributes(self.mesh)], axis=1), state
        )
        vertices, attributes = positions[state.vertices, :3], positions[state.vertices, 3:]
        vertex_source, triangle_source = (
            state.vertices.astype(np.int32),
            state.triangle_indices.astype(np.int32),
        )
        if fit:
            reduced = ReducedMesh(vertices, attributes, state.triangles, vertex_source, state.merged_into)
            try:
                vertices, attributes = fit_to_input(
                    reduced, make_kernel_input(self.mesh), self.lock, 0, ignore_progress
                )
            except _kernels.InvalidMeshError as error:
                raise MeshError(
                    SIMPLIFY_RECORD_INVALID, "the mesh of the record cannot be fitted: {error}.", error=error
                ) from error
        mesh = build_result_mesh(self.mesh, vertices, attributes, state.triangles, vertex_source, "replay")
        if self.vertex_source is not None and self.triangle_source is not None:
            vertex_source = self.vertex_source[vertex_source]
            triangle_source = self.triangle_source[triangle_source]
        return ReplayedMesh(mesh, vertex_source, triangle_source, state.collapses)

    def _replay_wedges(self, wedges: Wedges, state: ReplayState) -> ReplayedMesh:
        attributes = wedges.attributes
        input_vertices = self.mesh.triangles.reshape(-1)[wedges.find_first_corners()]
        positions = self._move_survivors(attributes.positions[input_vertices] - attributes.origin, state)
        triangle_source = wedges.kept_triangles[state.triangle_indices]
        corners, corner_source = wedges.compute_corners_after(state.collapses, triangle_source)
        simplified = SimplifiedCorners(
            positions=positions[state.vertices],
            triangles=state.triangles,
            corners=corners,
            corner_source=corner_source.astype(np.int32),
            vertex_source=input_vertices[state.vertices].astype(np.int32),
            triangle_source=triangle_source.astype(np.int32),
        )
        mesh, vertex_source = attributes.to_mesh(self.mesh, simplified)
        return ReplayedMesh(mesh, vertex_source, simplified.triangle_source, state.collapses)

    def _move_survivors(self, positions: Floats, state: ReplayState) -> Floats:
        # NumPy keeps the last of several values assigned to one vertex.
        positions[self.survivor[: state.collapses]] = self.path[: state.collapses]
        return positions

    def save(self, path: Path | str) -> None:
        """Write the record to an `.npz` file for `load_record`.

        Raises
        ------
        StageError
            If the file cannot be written.
        """
        mesh = self.mesh
        of_wedges: Arrays = {}
        metadata: dict[str, Any] = {"content": "collapses of vertices", "collapses": len(self.removed)}
        if self.wedges is None:
            # Other attributes cannot be replayed.
            mesh = Mesh(mesh.vertices, mesh.triangles, mesh.colors, mesh.normals, up=mesh.up)
        else:
            metadata["content"] += " and wedges"
            of_wedges, metadata["wedges"] = serialize_wedges(self.wedges)
        of_mesh, metadata["mesh"] = serialize_mesh(mesh)
        arrays = {
            "scanloom_collapse_record": np.array(FORMAT_VERSION),
            "about": np.array(json.dumps(metadata)),
            **{f"mesh/{name}": array for name, array in of_mesh.items()},
            "removed": self.removed,
            "survivor": self.survivor,
            "path": self.path,
            "lock": self.lock,
            "vertex_source": self.vertex_source,
            "triangle_source": self.triangle_source,
            **{f"wedges/{name}": array for name, array in of_wedges.items()},
        }
        write_arrays(Path(path), {name: array for name, array in arrays.items() if array is not None})
