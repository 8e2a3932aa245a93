"""Normal meshes in memory and as progressive `.snm` files.

A normal mesh is a base mesh and refinements that need one scalar per new vertex. A file stores the base mesh
followed by one refinement after the other. A prefix that ends at a level boundary is a valid file of a
coarser mesh.
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
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.lod.codes import LEVELS_FILE_DAMAGED
from scanloom.stages.normal_meshes.codes import LEVELS_LEVEL_MISSING
from scanloom.stages.printing import format_by_fields, format_by_metrics, render_table
from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh, require_writable
from scanloom.stages.surface.mesh_files import write_mesh

# Encoding of a new vertex: a scalar along the predicted normal; a vector, where the normal does not hit the
# surface; a vector, because the vertex is on the boundary.
SCALAR, EXCEPTION, BOUNDARY = 0, 1, 2


@dataclass(frozen=True, eq=False)
class Offsets:
    """Offsets of the k vertices of one refinement from their predicted positions.

    The refinement adds one vertex per edge of the level before, after the vertices of that level.

    Attributes
    ----------
    kinds : (k,) uint8, SCALAR, EXCEPTION or BOUNDARY.
    values : (k, 3) float64, metres: components along the normal and two tangents. A SCALAR has only the
        first.
    predicted : (k, 3) float64, predicted positions in metres. A SCALAR vertex is at `predicted` plus its
        value
        times the normal.
    normals : (k, 3) float64, unit normals estimated from the level before.
    """

    kinds: NDArray[np.uint8]
    values: NDArray[np.float64]
    predicted: NDArray[np.float64]
    normals: NDArray[np.float64]

    __repr__ = format_by_fields

    def count(self, kind: int) -> int:
        """Count the vertices of a kind: SCALAR, EXCEPTION or BOUNDARY."""
        return int(np.count_nonzero(self.kinds == kind))


@dataclass(frozen=True, eq=False)
class NormalMesh:
    """A mesh at several levels of detail, and its encoded file.

    Attributes
    ----------
    levels : the base mesh, then one mesh per refinement. Each has four times the triangles of the level
        before
        and begins with the vertices of that level, unchanged.
    offsets : `offsets[k]` refines `levels[k]` to `levels[k + 1]`.
    confidence : (n,) float64 per level; None if the vertices have no confidence.
    encoded_levels : number of refinements in the original file; `levels` can hold fewer.
    damage : error in the remaining part of the file; None if there is no error.
    data : encoded file, up to the end of the finest level in `levels`.
    level_ends : end of each level in `data`, in bytes.
    base_source : (n,) int32, input vertex of each base vertex. If the base is the simplified mesh: an input
        vertex that was merged into it. None if decoded.
    triangle_source : (n,) int32 per level, the input triangle that each vertex lies on or is nearest to. None
        if decoded.
    folded_by_level : number of triangles per level that are flipped relative to the surface or have no area;
        empty if decoded.
    tolerance : maximum distance by which rounding moves a vertex off the surface, as a ratio of the diagonal
        of
        the input's bounding box; None if decoded.
    tolerance_m : the same in metres.
    tolerance_source : origin of the tolerance as text for people; None if decoded.
    max_distances_m : largest measured distance in metres between each level and the input; empty without
        `max_error`.
    relaxed : the finest level after the paper's tangential steps (`tangential_steps`), which the file does
        not contain; None without.
    diagnostics : warnings about dropped or changed data, and an unmet requirement if `max_error` was not
        reached.
    """

    levels: tuple[Mesh, ...]
    offsets: tuple[Offsets, ...]
    confidence: tuple[NDArray[np.float64], ...] | None
    encoded_levels: int
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
    relaxed: Mesh | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    @property
    def base(self) -> Mesh:
        """The base mesh."""
        return self.levels[0]

    @property
    def folded_count(self) -> int:
        """Number of flipped or degenerate triangles in the finest level; 0 if decoded."""
        return self.folded_by_level[-1] if self.folded_by_level else 0

    @property
    def mesh(self) -> Mesh:
        """The finest level, after tangential steps if there are any."""
        return self.levels[-1] if self.relaxed is None else self.relaxed

    def to_dict(self) -> dict[str, Any]:
        """Return counts and sizes as JSON-compatible values.

        `exception_ratio` is the ratio of EXCEPTION vertices to all new vertices that are not on the
        boundary.
        """
        by_level = [self._summarize_level(level) for level in range(len(self.levels))]
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
            "levels_encoded": self.encoded_levels,
            "base_triangles": len(self.base.triangles),
            "exceptions": exceptions,
            "exception_ratio": exceptions / inside if inside else 0.0,
            "folded_triangles": self.folded_count,
            **{name: value for name, value in rounding.items() if value is not None},
            "file_bytes": len(self.data),
            "bits_per_vertex": 8 * len(self.data) / max(len(self.mesh.vertices), 1),
            "by_level": by_level,
            "damage": self.damage,
        }

    def _summarize_level(self, level: int) -> dict[str, Any]:
        metrics: dict[str, Any] = {
            "level": level,
            "triangles": len(self.levels[level].triangles),
            "vertices": len(self.levels[level].vertices),
            "exceptions": 0,
            "boundary_vertices": 0,
            "file_bytes": self.level_ends[level],
        }
        if level > 0:
            offsets = self.offsets[level - 1]
            metrics |= {
                "exceptions": offsets.count(EXCEPTION),
                "boundary_vertices": offsets.count(BOUNDARY),
            }
        if level < len(self.folded_by_level):
            metrics["folded_triangles"] = self.folded_by_level[level]
        if level < len(self.max_distances_m):
            metrics["max_distance_m"] = self.max_distances_m[level]
        return metrics

    def save(self, path: Path | str, level: int | None = None) -> None:
        """Write the encoded file, optionally truncated after a level.

        Parameters
        ----------
        path : output file, usually with the extension `.snm`.
        level : last level to store, 0 for the base mesh; None for all levels.

        Raises
        ------
        UsageError
            If the level does not exist.
        MeshError
            If coordinates are not finite.
        StageError
            If the file cannot be written.
        """
        end = self.level_ends[-1 if level is None else self._require_level(level)]
        for coarse in self.levels:
            require_writable(coarse, path)
        with write_file_atomically(Path(path)) as part:
            part.write_bytes(self.data[:end])

    def write(self, path: Path | str, level: int | None = None) -> None:
        """Write the mesh of one level with `write_mesh`; None for `mesh`.

        A PLY file also stores the confidence as a vertex property.

        Raises
        ------
        UsageError
            If the level does not exist or the extension is unknown.
        StageError
            If the file cannot be written.
        """
        path, number = Path(path), -1 if level is None else self._require_level(level)
        mesh = self.mesh if level is None else self.levels[number]
        if self.confidence is None or path.suffix.lower() != ".ply":
            write_mesh(path, mesh)
        else:
            write_ply(path, mesh, vertex_values={"confidence": self.confidence[number]})

    def write_levels(self, folder: Path | str) -> tuple[Path, ...]:
        """Write every level as `level_0.ply`, `level_1.ply`, … and return the paths.

        The folder is created if it does not exist.

        Raises
        ------
        StageError
            If a file cannot be written.
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
    """Decode an `.snm` file; the meshes are bit-identical to the result of `remesh`.

    From a truncated or damaged file, the intact levels are returned and `damage` describes the error. A file
    truncated at a level boundary is valid; `encoded_levels` still holds its original number of refinements.

    Parameters
    ----------
    source : path of a file, or its content.
    level : finest level to decode, 0 for the base mesh; None for all levels.

    Raises
    ------
    InputError
        If the file cannot be read, is not an `.snm` file or has another version. Also if the damage affects
        the base mesh, or a level up to `level`.
    UsageError
        If the file was never encoded with this level.
    """
    if level is not None and level < 0:
        raise UsageError(LEVELS_LEVEL_MISSING, "level is {level}; it must be at least 0.", level=level)
    if isinstance(source, (str, Path)):
        where = str(source)
        try:
            data = read_input_bytes(Path(source))
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
    if level is not None and level > found.encoded_levels:
        raise UsageError(
            LEVELS_LEVEL_MISSING,
            "level is {level}, but {place} was encoded with levels 0 to {promised}.",
            level=level,
            place=where,
            promised=found.encoded_levels,
        )
    if level is not None and level > found.levels:
        why = found.damage or "the file ends there"
        raise InputError(
            LEVELS_LEVEL_MISSING,
            "has no level {level}; only levels 0 to {levels} are intact: {why}.",
            where,
            level=level,
            levels=found.levels,
            why=why,
        )
    return convert_kernel_mesh(found)


def convert_kernel_mesh(
    found: _kernels.NormalMesh, mesh_diagnostics: tuple[Diagnostic, ...] = (), **known: Any
) -> NormalMesh:
    """Convert the kernel's result to a NormalMesh.

    Parameters
    ----------
    found : result of the remeshing or decoding kernel.
    mesh_diagnostics : diagnostics of the input mesh, attached to the mesh of each level.
    known : further fields of the NormalMesh.
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
        encoded_levels=found.encoded_levels,
        damage=found.damage,
        data=found.data,
        level_ends=tuple(found.level_ends),
        **known,
    )
