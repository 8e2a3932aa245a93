"""The collapses of a simplification, kept so that any of its intermediate meshes can be had again.

The record is a progressive mesh (Hoppe, "Progressive meshes", 1996) in its plainest form: the input, and for
each collapse which vertex went into which other, and where that one went. A prefix of it sends every vertex
to the one it is part of by then, for all collapses at once.
"""

from __future__ import annotations

import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files.replacing import replacing
from stages.params import resolve
from stages.progress import silent
from stages.simplification.kernel_input import Light, as_result, attributes_of, centred, fitted
from stages.simplification.records.seam_record import SeamRecord, seam_record_of
from stages.simplification.records.steps import Replayed, ReplayParams, Steps, roots
from stages.surface.mesh import Mesh, validated

_FORMAT = 1
# What reading an archive can raise; RuntimeError is for an encryption or compression nobody asked for.
_DAMAGE = (ValueError, KeyError, EOFError, RuntimeError, MemoryError, zipfile.BadZipFile, zlib.error)
_NEEDED = ("vertices", "triangles", "removed", "survivor", "path", "lock")


@dataclass(frozen=True, eq=False)
class CollapseRecord:
    """All collapses of one run of `simplify`.

    Attributes
    ----------
    mesh : what they began with: the input without its texture, with its long edges split where `jia01` did.
    removed, survivor : (m,) int32, for each collapse the input vertex that vanished and the one it went into.
    path : (m, 3 + k) float64, where the survivor went: metres, then colours in 8-bit levels if there are any.
    lock : (n,) bool, vertices that stay as they are.
    vertex_source, triangle_source : (n,) and (t,) int32, the vertex and triangle of the input that those of
        `mesh` come from; None where `mesh` has those of the input.
    """

    mesh: Mesh
    removed: NDArray[np.int32]
    survivor: NDArray[np.int32]
    path: NDArray[np.float64]
    lock: NDArray[np.bool_]
    vertex_source: NDArray[np.int32] | None = None
    triangle_source: NDArray[np.int32] | None = None

    @cached_property
    def _steps(self) -> Steps:
        return Steps(self.mesh.triangles, len(self.mesh.vertices), self.removed, self.survivor)

    def triangles_after(self, collapses: int) -> int:
        """Return how many triangles are left after so many collapses."""
        return self._steps.triangles_after(collapses)

    def replay(self, params: ReplayParams | None = None, **changes: Any) -> Replayed:
        """Return the mesh as it was when so many triangles were left, or after so many collapses.

        It is a manifold of the input's topology at every step. At the last it equals what `simplify` gave
        out, to the bit, if both are fitted or neither is.

        Parameters
        ----------
        params : ReplayParams; single fields can be given by name instead.

        Raises
        ------
        UsageError
            For fewer triangles or more collapses than the record leads to.
        """
        params = resolve(ReplayParams, params, changes)
        collapses = self._steps.wanted(params)
        place = np.concatenate([self.mesh.vertices, attributes_of(self.mesh)], axis=1)
        # Of several values for one vertex, the last one stays.
        place[self.survivor[:collapses]] = self.path[:collapses]
        root = roots(len(place), self.removed[:collapses], self.survivor[:collapses])
        left = np.flatnonzero(self._steps.ends >= collapses)
        corners = root[self.mesh.triangles[left]]
        used = np.zeros(len(place), bool)
        used[corners] = True
        source = np.flatnonzero(used)
        number = np.full(len(place), -1, np.int32)
        number[source] = np.arange(len(source))
        vertex_source, triangles = source.astype(np.int32), number[corners]
        vertices, attributes = place[source, :3], place[source, 3:]
        if params.fit:
            light = Light(vertices, attributes, triangles, vertex_source, became=number[root])
            vertices, attributes = fitted(light, centred(self.mesh), self.lock, 0, silent)
        mesh = as_result(self.mesh, vertices, attributes, triangles, vertex_source, "replay")
        triangle_source = left.astype(np.int32)
        if self.vertex_source is not None and self.triangle_source is not None:
            vertex_source, triangle_source = self.vertex_source[vertex_source], self.triangle_source[left]
        return Replayed(mesh, vertex_source, triangle_source, collapses)

    def save(self, path: Path | str) -> None:
        """Write the record to a file that `load_record` reads, `.npz` by custom.

        Raises
        ------
        StageError
            If the system refuses to write.
        """
        mesh = self.mesh
        arrays: dict[str, Any] = {
            "scanloom_collapse_record": np.array(_FORMAT),
            "vertices": mesh.vertices,
            "triangles": mesh.triangles,
            "colors": mesh.colors,
            "normals": mesh.normals,
            "removed": self.removed,
            "survivor": self.survivor,
            "path": self.path,
            "lock": self.lock,
            "vertex_source": self.vertex_source,
            "triangle_source": self.triangle_source,
        }
        with replacing(Path(path)) as part, part.open("wb") as file:
            np.savez(file, **{name: array for name, array in arrays.items() if array is not None})


def load_record(path: Path | str) -> CollapseRecord | SeamRecord:
    """Read a record that `CollapseRecord.save` or `SeamRecord.save` wrote.

    Raises
    ------
    InputError
        If the file is missing, damaged, no record, or of another version.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            content = np.load(file, allow_pickle=False)
            arrays = dict(content) if isinstance(content, np.lib.npyio.NpzFile) else {}
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}.", path) from error
    except _DAMAGE as error:
        raise InputError("is damaged, or no record of collapses.", path) from error
    if "scanloom_seam_record" in arrays:
        return seam_record_of(arrays, path)
    version = arrays.get("scanloom_collapse_record")
    if version is None:
        raise InputError("is no record of collapses.", path)
    if version.shape != () or version != _FORMAT:
        raise InputError(f"is a record of version {version}; this scanloom reads version {_FORMAT}.", path)
    missing = [name for name in _NEEDED if name not in arrays]
    if missing:
        raise InputError(f"is damaged: it has no {missing[0]}.", path)
    mesh = validated(
        Mesh(arrays["vertices"], arrays["triangles"], arrays.get("colors"), arrays.get("normals")), str(path)
    )
    record = CollapseRecord(
        mesh,
        *(arrays[name] for name in ("removed", "survivor", "path", "lock")),
        *(arrays.get(name) for name in ("vertex_source", "triangle_source")),
    )
    _require_sound(record, path)
    return record


def _require_sound(record: CollapseRecord, path: Path) -> None:
    """Refuse a record whose collapses cannot have taken place on its mesh."""
    count, collapses = len(record.mesh.vertices), record.removed.size
    shapes: dict[str, tuple[NDArray[Any], type, list[tuple[int, ...]]]] = {
        "removed": (record.removed, np.int32, [(collapses,)]),
        "survivor": (record.survivor, np.int32, [(collapses,)]),
        "path": (record.path, np.float64, [(collapses, 3 + attributes_of(record.mesh).shape[1])]),
        "lock": (record.lock, np.bool_, [(count,)]),
    }
    for name, (array, kind, allowed) in shapes.items():
        if array.dtype != kind or array.shape not in allowed:
            raise InputError(f"is damaged: {name} is {array.dtype} of shape {array.shape}.", path)
    sources = {"vertex_source": (record.vertex_source, count)}
    sources["triangle_source"] = (record.triangle_source, len(record.mesh.triangles))
    for name, (source, length) in sources.items():
        if source is not None and (source.dtype != np.int32 or source.shape != (length,)):
            raise InputError(f"is damaged: {name} is {source.dtype} of shape {source.shape}.", path)
    for name, ids in (("removed", record.removed), ("survivor", record.survivor)):
        if collapses and not (ids.min() >= 0 and ids.max() < count):
            raise InputError(f"is damaged: {name} names a vertex that is not there.", path)
    if not np.isfinite(record.path).all():
        raise InputError("is damaged: a vertex goes to a place that is not finite.", path)
    when = np.full(count, collapses)
    when[record.removed] = np.arange(collapses)
    # A vertex that is removed twice has the later number; one that went into itself has its own.
    ordered = (when[record.removed] == np.arange(collapses)) & (when[record.survivor] > np.arange(collapses))
    if not ordered.all():
        wrong = int(np.flatnonzero(~ordered)[0])
        raise InputError(f"is damaged: collapse {wrong} has a vertex that is gone already.", path)
