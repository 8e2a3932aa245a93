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
from scanloom.stages.surface.formats.colors import to_uint8
from scanloom.stages.surface.mesh import Mesh

# Points per chunk.
PART = 1 << 20
# Clouds with more points are refused: they need more memory than most machines have.
MOST_POINTS = 100_000_000
# Maximum plausible points per byte of a file: a million equal points take 7 kB as LAZ.
_MOST_PER_BYTE = 256

_POINTS, _COLORS, _NORMALS = "points.f8", "colors.u2", "normals.f8"
_TYPES = {_POINTS: np.float64, _COLORS: np.uint16, _NORMALS: np.float64}


class Parts:
    """Writer of a cloud's chunks to files in a folder.

    Parameters
    ----------
    folder : folder of the chunk files.
    path : cloud file, for messages.
    """

    def __init__(self, folder: Path, path: Path) -> None:
        self._folder, self._path = folder, path
        self._counts = dict.fromkeys(_TYPES, 0)
        self._brightest = 0
        self._promised = 0

    def promise(self, points: int) -> None:
        """Check an announced point count before the points are read.

        Raises
        ------
        InputError
            If the total exceeds the size of the file or MOST_POINTS.
        """
        self._promised += points
        if self._promised > _MOST_PER_BYTE * self._path.stat().st_size:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "declares {points:,} points, more than its size allows; it is damaged or cut short.",
                self._path,
                points=points,
            )
        if self._promised > MOST_POINTS:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "holds {promised:,} points, more than the limit of {most_points:,}. Subsample it first.",
                self._path,
                promised=self._promised,
                most_points=MOST_POINTS,
            )

    def append(
        self, points: NDArray[Any], colors: NDArray[Any] | None = None, normals: NDArray[Any] | None = None
    ) -> None:
        """Append points (k, 3) in metres with optional colours and normals.

        Colours (k, 3) are 0 to 65535, or 0 to 255 if no colour of the cloud exceeds 255. Normals are (k, 3).
        """
        if colors is not None and len(colors):
            self._brightest = max(self._brightest, int(colors.max()))
        for name, values in ((_POINTS, points), (_COLORS, colors), (_NORMALS, normals)):
            if values is not None:
                self._counts[name] += len(values)
                with (self._folder / name).open("ab") as file:
                    np.ascontiguousarray(values, _TYPES[name]).tofile(file)

    def told(self) -> dict[str, Any]:
        """Return the metadata that `collected` needs, as JSON-compatible values."""
        return {"counts": self._counts, "brightest": self._brightest}


def collected(folder: Path, told: dict[str, Any], path: Path) -> Mesh:
    """Assemble the cloud from the chunk files in a folder.

    Diagnostics of the reader process are emitted again.

    Parameters
    ----------
    folder : folder of the chunk files.
    told : metadata from `Parts.told`, plus "diagnostics".
    path : cloud file, for messages.
    """
    emit(*(Diagnostic.from_figures(figures) for figures in told["diagnostics"]))
    counts = told["counts"]
    count = counts[_POINTS]
    read = {name: _read(folder / name, kind, counts[name]) for name, kind in _TYPES.items() if counts[name]}
    for name, called in ((_COLORS, "colours"), (_NORMALS, "normals")):
        if name in read and counts[name] != count:
            del read[name]
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
    if _COLORS in read:
        colors = _levels(read[_COLORS], told["brightest"], path)
    return Mesh(
        read.get(_POINTS, np.zeros((0, 3))),
        np.zeros((0, 3), np.int32),
        colors,
        read.get(_NORMALS),
    )


def _read(path: Path, kind: Any, count: int) -> NDArray[Any]:
    return np.fromfile(path, kind, 3 * count).reshape(-1, 3)


def _levels(colors: NDArray[np.uint16], brightest: int, path: Path) -> NDArray[np.uint8] | None:
    """Convert colours to 8 bits; None if all are 0, which means no colours."""
    if brightest == 0:
        emit(MESH_LEFT_OUT.warning("its colours are left out: all of them are 0", path))
        return None
    if brightest <= np.iinfo(np.uint8).max:
        return colors.astype(np.uint8)
    return to_uint8(colors)
