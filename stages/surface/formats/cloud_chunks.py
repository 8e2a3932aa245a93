"""Transfer of a point cloud between processes in plain binary files.

The reader process appends points in chunks, so it never holds more than one chunk in memory.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.surface.codes import MESH_CLOUD_DAMAGED, MESH_LEFT_OUT
from scanloom.stages.surface.formats.color_conversion import to_uint8
from scanloom.stages.surface.mesh import Mesh

# Points per chunk.
CHUNK_POINTS = 1 << 20
# Clouds with more points are refused: they need more memory than most machines have.
MAX_POINTS = 100_000_000
# Maximum plausible points per byte of a file: a million equal points take 7 kB as LAZ.
_MAX_POINTS_PER_BYTE = 256

_POINTS_FILE, _COLORS_FILE, _NORMALS_FILE = "points.f8", "colors.u2", "normals.f8"
_TYPES = {_POINTS_FILE: np.float64, _COLORS_FILE: np.uint16, _NORMALS_FILE: np.float64}


class CloudChunkWriter:
    """Writer of a cloud's chunks to files in a folder.

    Parameters
    ----------
    folder : folder of the chunk files.
    path : cloud file, for messages.
    """

    def __init__(self, folder: Path, path: Path) -> None:
        self._folder, self._path = folder, path
        self._counts = dict.fromkeys(_TYPES, 0)
        self._max_color = 0
        self._declared_points = 0

    def check_point_count(self, points: int) -> None:
        """Check an announced point count before the points are read.

        Raises
        ------
        InputError
            If the total exceeds the size of the file or MAX_POINTS.
        """
        self._declared_points += points
        if self._declared_points > _MAX_POINTS_PER_BYTE * self._path.stat().st_size:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "declares {points:,} points, more than its size allows; it is damaged or cut short.",
                self._path,
                points=points,
            )
        if self._declared_points > MAX_POINTS:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "holds {promised:,} points, more than the limit of {most_points:,}. Subsample it first.",
                self._path,
                promised=self._declared_points,
                most_points=MAX_POINTS,
            )

    def append(
        self, points: NDArray[Any], colors: NDArray[Any] | None = None, normals: NDArray[Any] | None = None
    ) -> None:
        """Append points (k, 3) in metres with optional colours and normals.

        Colours (k, 3) are 0 to 65535, or 0 to 255 if no colour of the cloud exceeds 255. Normals are (k, 3).
        """
        if colors is not None and len(colors):
            self._max_color = max(self._max_color, int(colors.max()))
        for name, values in ((_POINTS_FILE, points), (_COLORS_FILE, colors), (_NORMALS_FILE, normals)):
            if values is not None:
                self._counts[name] += len(values)
                with (self._folder / name).open("ab") as file:
                    np.ascontiguousarray(values, _TYPES[name]).tofile(file)

    def get_metadata(self) -> dict[str, Any]:
        """Return the metadata that `assemble_cloud` needs, as JSON-compatible values."""
        return {"counts": self._counts, "brightest": self._max_color}


def assemble_cloud(folder: Path, metadata: dict[str, Any], path: Path) -> Mesh:
    """Assemble the cloud from the chunk files in a folder.

    Diagnostics of the reader process are emitted again.

    Parameters
    ----------
    folder : folder of the chunk files.
    metadata : metadata from `CloudChunkWriter.get_metadata`, plus "diagnostics".
    path : cloud file, for messages.
    """
    emit(*(Diagnostic.from_dict(metrics) for metrics in metadata["diagnostics"]))
    counts = metadata["counts"]
    count = counts[_POINTS_FILE]
    arrays = {
        name: _read_chunk_file(folder / name, kind, counts[name])
        for name, kind in _TYPES.items()
        if counts[name]
    }
    for name, called in ((_COLORS_FILE, "colours"), (_NORMALS_FILE, "normals")):
        if name in arrays and counts[name] != count:
            del arrays[name]
            emit(
                MESH_LEFT_OUT.warning(
                    "the {called} are left out: only {having:,} of {count:,} points have them",
                    path,
                    called=called,
                    having=counts[name],
                    count=count,
                )
            )
    colors = None
    if _COLORS_FILE in arrays:
        colors = _convert_colors(arrays[_COLORS_FILE], metadata["brightest"], path)
    return Mesh(
        arrays.get(_POINTS_FILE, np.zeros((0, 3))),
        np.zeros((0, 3), np.int32),
        colors,
        arrays.get(_NORMALS_FILE),
    )


def _read_chunk_file(path: Path, dtype: Any, count: int) -> NDArray[Any]:
    return np.fromfile(path, dtype, 3 * count).reshape(-1, 3)


def _convert_colors(colors: NDArray[np.uint16], max_color: int, path: Path) -> NDArray[np.uint8] | None:
    """Convert colours to 8 bits; None if all are 0, which means no colours."""
    if max_color == 0:
        emit(MESH_LEFT_OUT.warning("its colours are left out: all of them are 0", path))
        return None
    if max_color <= np.iinfo(np.uint8).max:
        return colors.astype(np.uint8)
    return to_uint8(colors)
