"""The collapses of a simplification, kept so that any of its intermediate meshes can be had again.

The record is a progressive mesh (Hoppe, "Progressive meshes", 1996) in its plainest form: the input, and for
each collapse which vertex went into which other, and where that one went. A prefix of it sends every vertex
to the one it is part of by then, for all collapses at once.
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
from scanloom.stages.printing import by_fields, table
from scanloom.stages.progress import silent
from scanloom.stages.simplification.codes import SIMPLIFY_RECORD_INVALID
from scanloom.stages.simplification.corner_attributes import LightCorners
from scanloom.stages.simplification.kernel_input import Floats, Ids, Light, as_result, fitted, kernel_input
from scanloom.stages.simplification.records.archive import Arrays, write_arrays
from scanloom.stages.simplification.records.steps import After, Replayed, ReplayParams, Steps
from scanloom.stages.simplification.records.stored_mesh import stored_mesh
from scanloom.stages.simplification.records.stored_wedges import stored_wedges
from scanloom.stages.simplification.records.wedges import Wedges
from scanloom.stages.surface.color import attributes_of
from scanloom.stages.surface.mesh import Mesh

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from scanloom.stages.params.keywords import ReplayKeywords


FORMAT_VERSION = 2


@dataclass(frozen=True, eq=False)
class CollapseRecord:
    """All collapses of one run of `simplify`.

    Attributes
    ----------
    mesh : what they began with: the input, with its long edges split where `jia01` did; without what cannot
        be replayed, which is everything at corners if there are no wedges.
    removed, survivor : (m,) int32, for each collapse the vertex that vanished and the one it went into.
        Vertices are those of `mesh`, or as the wedges number them.
    path : (m, 3 + k) float64, where the survivor went: metres, then colours in 8-bit levels if there are any.
        With wedges (m, 3), from the origin of their attributes.
    lock : (n,) bool, vertices of `mesh` that stay as they are.
    vertex_source, triangle_source : (n,) and (t,) int32, the vertex and triangle of the input that those of
        `mesh` come from; None where `mesh` has those of the input.
    wedges : what became of the corners, where they have attributes of their own.
    """

    __repr__ = by_fields
    _repr_html_ = table

    mesh: Mesh
    removed: Ids
    survivor: Ids
    path: Floats
    lock: NDArray[np.bool_]
    vertex_source: Ids | None = None
    triangle_source: Ids | None = None
    wedges: Wedges | None = None

    @cached_property
    def _steps(self) -> Steps:
        if self.wedges is None:
            return Steps(self.mesh.triangles, len(self.mesh.vertices), self.removed, self.survivor)
        return Steps(self.wedges.triangles, self.wedges.vertices, self.removed, self.survivor)

    def triangles_after(self, collapses: int) -> int:
        """Return how many triangles are left after so many collapses."""
        return self._steps.triangles_after(collapses)

    def replay(self, params: ReplayParams | None = None, **changes: Unpack[ReplayKeywords]) -> Replayed:
        """Return the mesh as it was when so many triangles were left, or after so many collapses.

        It has the input's topology at every step. At the last it equals what `simplify` gave out, to the bit,
        if both are fitted or neither is.

        Parameters
        ----------
        params : ReplayParams; single fields can be given by name instead.

        Raises
        ------
        UsageError
            For fewer triangles or more collapses than the record leads to, and for `fit` with wedges, whose
            fit needs the whole run.
        MeshError
            If `fit` cannot work on a mesh that somebody else wrote into the record.
        """
        params = resolve(ReplayParams, params, dict(changes))
        if self.wedges is None:
            with collecting() as diagnostics:
                found = self._vertices_after(self._steps.after(self._steps.wanted(params)), fit=params.fit)
            return replace(found, diagnostics=tuple(diagnostics))
        if params.fit:
            raise UsageError(
                SIMPLIFY_RECORD_INVALID,
                "a record of method seams cannot be fitted",
                remedy="simplify to that number instead.",
            )
        return self._wedges_after(self.wedges, self._steps.after(self._steps.wanted(params)))

    def _vertices_after(self, after: After, *, fit: bool) -> Replayed:
        place = self._moved(np.concatenate([self.mesh.vertices, attributes_of(self.mesh)], axis=1), after)
        vertices, attributes = place[after.vertices, :3], place[after.vertices, 3:]
        vertex_source, triangle_source = after.vertices.astype(np.int32), after.rows.astype(np.int32)
        if fit:
            light = Light(vertices, attributes, after.triangles, vertex_source, after.became)
            try:
                vertices, attributes = fitted(light, kernel_input(self.mesh), self.lock, 0, silent)
            except _kernels.InvalidMeshError as error:
                raise MeshError(
                    SIMPLIFY_RECORD_INVALID, "the mesh of the record cannot be fitted: {error}.", error=error
                ) from error
        mesh = as_result(self.mesh, vertices, attributes, after.triangles, vertex_source, "replay")
        if self.vertex_source is not None and self.triangle_source is not None:
            vertex_source = self.vertex_source[vertex_source]
            triangle_source = self.triangle_source[triangle_source]
        return Replayed(mesh, vertex_source, triangle_source, after.collapses)

    def _wedges_after(self, wedges: Wedges, after: After) -> Replayed:
        attributes = wedges.attributes
        inputs = self.mesh.triangles.reshape(-1)[wedges.first_corners()]
        place = self._moved(attributes.positions[inputs] - attributes.origin, after)
        triangle_source = wedges.kept[after.rows]
        corners, corner_source = wedges.corners_after(after.collapses, triangle_source)
        left = LightCorners(
            places=place[after.vertices],
            triangles=after.triangles,
            corners=corners,
            corner_source=corner_source.astype(np.int32),
            vertex_source=inputs[after.vertices].astype(np.int32),
            triangle_source=triangle_source.astype(np.int32),
        )
        mesh, vertex_source = attributes.as_mesh(self.mesh, left)
        return Replayed(mesh, vertex_source, left.triangle_source, after.collapses)

    def _moved(self, place: Floats, after: After) -> Floats:
        # Of several values for one vertex, the last one stays.
        place[self.survivor[: after.collapses]] = self.path[: after.collapses]
        return place

    def save(self, path: Path | str) -> None:
        """Write the record to a file that `load_record` reads, `.npz` by custom.

        Raises
        ------
        StageError
            If the system refuses to write.
        """
        mesh = self.mesh
        of_wedges: Arrays = {}
        about: dict[str, Any] = {"content": "collapses of vertices", "collapses": len(self.removed)}
        if self.wedges is None:
            # Nothing else of it can be replayed.
            mesh = Mesh(mesh.vertices, mesh.triangles, mesh.colors, mesh.normals, up=mesh.up)
        else:
            about["content"] += " and wedges"
            of_wedges, about["wedges"] = stored_wedges(self.wedges)
        of_mesh, about["mesh"] = stored_mesh(mesh)
        arrays = {
            "scanloom_collapse_record": np.array(FORMAT_VERSION),
            "about": np.array(json.dumps(about)),
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
