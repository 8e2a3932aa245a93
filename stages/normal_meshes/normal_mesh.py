"""Normal meshes: a base mesh and refinements of one number a vertex, in memory and as `.snm` files.

A file holds the base mesh and then one refinement after the other, so that its beginning, up to the end of
any level, is a file of a coarser mesh.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.opening import content_of
from scanloom.stages.files.replacing import replacing
from scanloom.stages.lod.codes import LEVELS_FILE_DAMAGED
from scanloom.stages.normal_meshes.codes import LEVELS_LEVEL_MISSING
from scanloom.stages.printing import by_fields, by_figures, table
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh, require_writable
from scanloom.stages.surface.mesh_files import write_mesh

# What stands for a new vertex: a number along the normal; a vector, since no number leads to the surface; a
# vector, since the vertex is on the boundary.
SCALAR, EXCEPTION, BOUNDARY = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Offsets:
    """Where the k vertices of one refinement are, from where they were predicted.

    They follow the vertices of the level before, one for each of its edges.

    Attributes
    ----------
    kinds : (k,) uint8, SCALAR, EXCEPTION or BOUNDARY.
    values : (k, 3) float64, metres, along the normal and two directions across; of a scalar only the first
        is not 0.
    predicted : (k, 3) float64, metres. A vertex with a scalar is there, plus so much of its normal.
    normals : (k, 3) float64, unit normals as they are estimated from the level before.
    """

    kinds: NDArray[np.uint8]
    values: NDArray[np.float64]
    predicted: NDArray[np.float64]
    normals: NDArray[np.float64]

    __repr__ = by_fields

    def count(self, kind: int) -> int:
        """Return how many vertices are of this kind."""
        return int(np.count_nonzero(self.kinds == kind))


@dataclass(frozen=True, eq=False)
class NormalMesh:
    """A mesh at several levels of detail, and the file that holds them.

    Attributes
    ----------
    levels : the base mesh, then each refinement: four times the triangles of the one before, whose vertices
        come first and stay where they are.
    offsets : `offsets[k]` leads from `levels[k]` to `levels[k + 1]`.
    confidence : for each level (n,) float64 as far as vertices carry any, else None.
    promised : refinements the file was made with; there may be fewer here.
    damage : what is wrong with the rest of the file, or None.
    data : the file, up to the end of the finest level here.
    level_ends : bytes of the file up to the end of each level.
    base_source : (n,) int32, the vertex of the input that each vertex of the base mesh was, or that became
        part of it where the base is the simplified mesh; None if decoded.
    triangle_source : for each level (n,) int32, the triangle of the input that each vertex lies on, or is
        next to; None if decoded.
    folded_by_level : for each level the triangles that are turned against the surface or have no area; empty
        if decoded.
    tolerance : how far rounding may take a vertex from the surface, over the diagonal of the input's box;
        None if decoded.
    tolerance_m : the same in metres.
    tolerance_source : where the tolerance comes from, in plain words; None if decoded.
    max_distances_m : for each level the largest distance found between it and the input; empty if `max_error`
        was not given.
    diagnostics : what was left out or changed, and whether `max_error` is not reached.
    """

    levels: tuple[Mesh, ...]
    offsets: tuple[Offsets, ...]
    confidence: tuple[NDArray[np.float64], ...] | None
    promised: int
    damage: str | None
    data: bytes
    level_ends: tuple[int, ...]
    base_source: NDArray[np.int32] | None = None
    triangle_source: tuple[NDArray[np.int32], ...] | None = None
    folded_by_level: tuple[int, ...] = ()
    tolerance: float | None = None
    tolerance_m: float | None = None
    tolerance_source: str | None = None
    max_distances_m: tuple[float, ...] = ()
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = by_figures
    _repr_html_ = table

    @property
    def base(self) -> Mesh:
        """The base mesh."""
        return self.levels[0]

    @property
    def folded(self) -> int:
        """Triangles of the finest level that are turned against the surface or have no area; 0 if decoded."""
        return self.folded_by_level[-1] if self.folded_by_level else 0

    @property
    def mesh(self) -> Mesh:
        """The finest level."""
        return self.levels[-1]

    def figures(self) -> dict[str, Any]:
        """Return counts and sizes, ready for JSON; shares of exceptions are of the new vertices inside."""
        by_level = [self._level_figures(level) for level in range(len(self.levels))]
        exceptions = sum(offsets.count(EXCEPTION) for offsets in self.offsets)
        inside = exceptions + sum(offsets.count(SCALAR) for offsets in self.offsets)
        rounding = {
            "tolerance": self.tolerance,
            "tolerance_m": self.tolerance_m,
            "tolerance_source": self.tolerance_source,
        }
        return {
            "triangles": len(self.mesh.triangles),
            "vertices": len(self.mesh.vertices),
            "levels": len(self.offsets),
            "levels_promised": self.promised,
            "base_triangles": len(self.base.triangles),
            "exceptions": exceptions,
            "exceptions_share": exceptions / inside if inside else 0.0,
            "folded_triangles": self.folded,
            **{name: value for name, value in rounding.items() if value is not None},
            "file_bytes": len(self.data),
            "bits_per_vertex": 8 * len(self.data) / len(self.mesh.vertices),
            "by_level": by_level,
            "damage": self.damage,
        }

    def _level_figures(self, level: int) -> dict[str, Any]:
        figures: dict[str, Any] = {
            "level": level,
            "triangles": len(self.levels[level].triangles),
            "vertices": len(self.levels[level].vertices),
            "exceptions": 0,
            "boundary_vertices": 0,
            "file_bytes": self.level_ends[level],
        }
        if level > 0:
            offsets = self.offsets[level - 1]
            figures |= {
                "exceptions": offsets.count(EXCEPTION),
                "boundary_vertices": offsets.count(BOUNDARY),
            }
        if level < len(self.folded_by_level):
            figures["folded_triangles"] = self.folded_by_level[level]
        if level < len(self.max_distances_m):
            figures["max_distance_m"] = self.max_distances_m[level]
        return figures

    def save(self, path: Path | str, level: int | None = None) -> None:
        """Write the file up to the end of a level, of all if none is given; `.snm` by custom.

        Raises
        ------
        UsageError
            For a level that is not there.
        StageError
            If the system refuses to write.
        """
        end = self.level_ends[-1 if level is None else self._require_level(level)]
        for coarse in self.levels:
            require_writable(coarse, path)
        with replacing(Path(path)) as part:
            part.write_bytes(self.data[:end])

    def write(self, path: Path | str, level: int | None = None) -> None:
        """Write the mesh of a level, the finest if none is given, as `write_mesh` does.

        A PLY file also gets the confidence, as a property of its vertices.

        Raises
        ------
        UsageError
            For a level that is not there, or an extension that stands for no format.
        StageError
            If the system refuses to write.
        """
        path, number = Path(path), -1 if level is None else self._require_level(level)
        if self.confidence is None or path.suffix.lower() != ".ply":
            write_mesh(path, self.levels[number])
        else:
            write_ply(path, self.levels[number], vertex_values={"confidence": self.confidence[number]})

    def write_levels(self, folder: Path | str) -> tuple[Path, ...]:
        """Write every level into a folder, made if need be, and return the files: level_0.ply and so on.

        Raises
        ------
        StageError
            If the system refuses to write.
        """
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        paths = tuple(folder / f"level_{level}.ply" for level in range(len(self.levels)))
        for level, path in enumerate(paths):
            self.write(path, level)
        return paths

    def _require_level(self, level: int) -> int:
        if not 0 <= level < len(self.levels):
            raise UsageError(
                LEVELS_LEVEL_MISSING,
                "level is {level}, but there are only levels 0 to {levels_count}.",
                level=level,
                levels_count=len(self.levels) - 1,
            )
        return level


def decode(source: bytes | Path | str, level: int | None = None) -> NormalMesh:
    """Return the meshes of an `.snm` file, equal to the bit to what `remesh` returned.

    Where the file is cut short or damaged, the levels before that are returned, and `damage` says what is
    wrong. A file that was cut at the end of a level is whole; `promised` tells how many there once were.

    Parameters
    ----------
    source : a file, or its content.
    level : decode no further than to this one; 0 is the base mesh.

    Raises
    ------
    InputError
        If the file cannot be read, is no `.snm` file or of another version; if it is damaged so early that
        not even the base mesh is whole, or before `level`.
    UsageError
        For a level that the file never had.
    """
    if level is not None and level < 0:
        raise UsageError(LEVELS_LEVEL_MISSING, "level is {level}; it must be at least 0.", level=level)
    if isinstance(source, (str, Path)):
        where = str(source)
        try:
            data = content_of(Path(source))
        except OSError as error:
            raise InputError(
                FILE_UNREADABLE, "cannot be read: {detail}.", where, detail=error.strerror or error
            ) from error
    else:
        where, data = "data", bytes(source)
    try:
        found = _kernels.decode_normal_mesh(data, -1 if level is None else level)
    except _kernels.SnmError as error:
        raise InputError(LEVELS_FILE_DAMAGED, "{error}.", where, error=error) from error
    if level is not None and level > found.promised:
        raise UsageError(
            LEVELS_LEVEL_MISSING,
            "level is {level}, but {place} was made with levels 0 to {promised}.",
            level=level,
            place=where,
            promised=found.promised,
        )
    if level is not None and level > found.levels:
        why = found.damage or "it was cut there"
        raise InputError(
            LEVELS_LEVEL_MISSING,
            "has no level {level}, only levels 0 to {levels} are whole: {why}.",
            where,
            level=level,
            levels=found.levels,
            why=why,
        )
    return normal_mesh_of(found)


def normal_mesh_of(
    found: _kernels.NormalMesh, mesh_diagnostics: tuple[Diagnostic, ...] = (), **known: Any
) -> NormalMesh:
    """Return what a kernel found, and what else is known of it.

    Parameters
    ----------
    mesh_diagnostics : of the mesh that was read, for the mesh of each level.
    """
    numbers = range(found.levels + 1)
    confidence = tuple(values for level in numbers if (values := found.confidence(level)) is not None)
    up = None if found.up is None else (found.up[0], found.up[1], found.up[2])
    return NormalMesh(
        levels=tuple(
            Mesh(
                found.vertices(level),
                found.triangles(level),
                found.colors(level),
                diagnostics=mesh_diagnostics,
                up=up,
            )
            for level in numbers
        ),
        offsets=tuple(
            Offsets(found.kinds(level), found.offsets(level), found.predicted(level), found.frames(level))
            for level in numbers[1:]
        ),
        confidence=confidence or None,
        promised=found.promised,
        damage=found.damage,
        data=found.data,
        level_ends=tuple(found.level_ends),
        **known,
    )
