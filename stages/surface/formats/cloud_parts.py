"""A cloud on its way from a file's reader to us: written to plain files, a part at a time.

So a reader never holds more than a part, however many points there are.
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

# Points at a time.
PART = 1 << 20
# More are not read: they would take more memory than most machines have.
MOST_POINTS = 100_000_000
# No honest file holds more points a byte: a million equal points take 7 kB as LAZ.
_MOST_PER_BYTE = 256

_POINTS, _COLORS, _NORMALS = "points.f8", "colors.u2", "normals.f8"
_TYPES = {_POINTS: np.float64, _COLORS: np.uint16, _NORMALS: np.float64}


class Parts:
    """Parts of a cloud, appended to files in a folder.

    Parameters
    ----------
    folder : that the files go to.
    path : of the cloud's file, for messages.
    """

    def __init__(self, folder: Path, path: Path) -> None:
        self._folder, self._path = folder, path
        self._counts = dict.fromkeys(_TYPES, 0)
        self._brightest = 0
        self._promised = 0

    def promise(self, points: int) -> None:
        """Refuse a number of points that the file cannot hold, or that are too many; before they are read."""
        self._promised += points
        if self._promised > _MOST_PER_BYTE * self._path.stat().st_size:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "promises {points:,} points, which do not fit in it; it is damaged or cut short.",
                self._path,
                points=points,
            )
        if self._promised > MOST_POINTS:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "holds {promised:,} points; up to {most_points:,} are read. Thin it out first.",
                self._path,
                promised=self._promised,
                most_points=MOST_POINTS,
            )

    def append(
        self, points: NDArray[Any], colors: NDArray[Any] | None = None, normals: NDArray[Any] | None = None
    ) -> None:
        """Append points (k, 3), metres, and what they have: colours (k, 3) to 65535, normals (k, 3)."""
        if colors is not None and len(colors):
            self._brightest = max(self._brightest, int(colors.max()))
        for name, values in ((_POINTS, points), (_COLORS, colors), (_NORMALS, normals)):
            if values is not None:
                self._counts[name] += len(values)
                with (self._folder / name).open("ab") as file:
                    np.ascontiguousarray(values, _TYPES[name]).tofile(file)

    def told(self) -> dict[str, Any]:
        """Return what `collected` has to know."""
        return {"counts": self._counts, "brightest": self._brightest}


def collected(folder: Path, told: dict[str, Any], path: Path) -> Mesh:
    """Return the cloud whose parts are in a folder: a mesh without triangles.

    Diagnostics of the process that read the file `path` are emitted again here.
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
    """Return 8-bit colours; None where all are 0, which stands for none."""
    if brightest == 0:
        emit(MESH_LEFT_OUT.warning("its colours are left out: all of them are 0", path))
        return None
    if brightest <= np.iinfo(np.uint8).max:
        return colors.astype(np.uint8)
    return to_uint8(colors)
