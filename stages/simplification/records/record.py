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
        """Return the number of triangles after a number of collapses."""
        return self._steps.triangles_after(collapses)

    def replay(self, params: ReplayParams | None = None, **changes: Unpack[ReplayKeywords]) -> Replayed:
        """Restore the mesh at a triangle count or number of collapses.

        The topology of the input is preserved at every step. The last step is bit-identical to the result of
        `simplify`, if both are fitted or neither is.

        Parameters
        ----------
        params : ReplayParams; single fields can be given as keywords instead.

        Returns
        -------
        Replayed

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
                found = self._vertices_after(self._steps.after(self._steps.wanted(params)), fit=params.fit)
            return replace(found, diagnostics=tuple(diagnostics))
        if params.fit:
            raise UsageError(
                SIMPLIFY_RECORD_INVALID,
                "a record of method seams cannot be fitted to the input",
                remedy="run simplify with that triangle count instead.",
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
        # NumPy keeps the last of several values assigned to one vertex.
        place[self.survivor[: after.collapses]] = self.path[: after.collapses]
        return place

    def save(self, path: Path | str) -> None:
        """Write the record to an `.npz` file for `load_record`.

        Raises
        ------
        StageError
            If the file cannot be written.
        """
        mesh = self.mesh
        of_wedges: Arrays = {}
        about: dict[str, Any] = {"content": "collapses of vertices", "collapses": len(self.removed)}
        if self.wedges is None:
            # Other attributes cannot be replayed.
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
