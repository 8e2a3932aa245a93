"""Calls xatlas, in a process of its own that stages.texturing.atlas starts with this file.

xatlas is native code that ends its process on some meshes; a finely triangulated sphere is one. This file
imports nothing of scanloom, so that it starts fast.

    python atlas_worker.py chart|pack PIPE <GIVEN.npz >FOUND.npz

PIPE is the number of a descriptor that is open, the other end of which is held by who started this.
"""

from __future__ import annotations

import ctypes
import io
import os
import resource
import signal
import sys
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np
import xatlas
from numpy.typing import NDArray

# Of charts: with the library's 2, a few charts come out so stretched that a hundredth of a fused room has a
# third of its texels; beyond 4 nothing changes.
_MAX_COST = 4.0
# Of the whole surface: without a limit the search for charts takes half as long again, for no fewer charts.
_MOST_OF_AREA = 1 / 4
# PR_SET_PDEATHSIG of Linux's prctl.
_SET_DEATH_SIGNAL = 1
# Packing again, each time a little denser or sparser, to fill the image.
_PACKINGS = 8
# Aim a little below the full size: charts do not shrink quite in proportion, for padding and rounding.
_AIM = 0.985


def chart(given: Mapping[str, Any]) -> dict[str, Any]:
    """Cut a surface into charts and flatten each.

    Parameters
    ----------
    given : `vertices` (n, 3) float32, edges some hundreds long; `triangles` (m, 3) uint32, of some area each;
        `groups` (m,), triangles of different ones are in different charts; `area`, of all triangles.

    Returns
    -------
    `corners` (m, 3, 2) float64, as on a plane for each chart, all to one scale; `charts` (m,) int64.
    """
    atlas = xatlas.Atlas()
    members = [np.flatnonzero(given["groups"] == group) for group in np.unique(given["groups"])]
    for rows in members:
        used, indices = np.unique(given["triangles"][rows], return_inverse=True)
        atlas.add_mesh(given["vertices"][used], indices.reshape(-1, 3).astype(np.uint32))
    options, packing = xatlas.ChartOptions(), xatlas.PackOptions()
    options.max_cost = _MAX_COST
    options.max_chart_area = float(given["area"]) * _MOST_OF_AREA
    packing.resolution = 1024
    atlas.generate(options, packing)
    corners = np.empty((len(given["triangles"]), 3, 2))
    charts = np.full(len(corners), -1, np.int64)
    count = 0
    for number, rows in enumerate(members):
        _, indices, uvs = atlas.get_mesh(number)
        corners[rows] = uvs[indices]
        for piece in range(atlas.get_mesh_chart_count(number)):
            charts[rows[np.asarray(atlas.get_mesh_chart(number, piece).faces, np.int64)]] = count
            count += 1
    return {"corners": corners * (atlas.width, atlas.height), "charts": charts}


def pack(given: Mapping[str, Any]) -> dict[str, Any]:
    """Arrange charts in a square image, as large as they fit.

    Parameters
    ----------
    given : `corners` and `charts` as above, of any scale; `size` of the image and `padding`, in texels;
        `density`, texels in a unit of `corners`, to start with.

    Returns
    -------
    `corners` in texels, and the `density` that fitted; nothing if they do not fit.
    """
    size, density = int(given["size"]), float(given["density"])
    best: dict[str, Any] = {}
    most, too_much = 0.0, np.inf
    for _ in range(_PACKINGS):
        corners, extent = _packed(given["corners"], given["charts"], density, int(given["padding"]))
        if extent > size:
            too_much = min(too_much, density)
        elif density > most:
            best, most = {"corners": corners, "density": density}, density
        if most > 0.96 * too_much or 0.95 * size < extent <= size:
            break
        density *= _AIM * size / extent
        if density >= too_much:
            density = (most + too_much) / 2
    return best


def _packed(
    corners: NDArray[np.float64], charts: NDArray[np.int64], density: float, padding: int
) -> tuple[NDArray[np.float64], int]:
    wedges, indices = np.unique(
        np.column_stack([np.repeat(charts, 3), corners.reshape(-1, 2)]), axis=0, return_inverse=True
    )
    atlas = xatlas.Atlas()
    atlas.add_uv_mesh(
        wedges[:, 1:].astype(np.float32),
        indices.reshape(-1, 3).astype(np.uint32),
        charts.astype(np.uint32)[:, None],
    )
    options = xatlas.PackOptions()
    options.texels_per_unit = density
    options.padding = padding
    atlas.generate(xatlas.ChartOptions(), options)
    _, found, uvs = atlas.get_mesh(0)
    extent = (atlas.width, atlas.height)
    return uvs[found].astype(np.float64) * extent, max(extent)


def _end_with(parent: int) -> None:
    """End this process as soon as the one that started it does, even if that was killed."""
    if sys.platform == "linux":
        # At once, whatever native code is at; elsewhere as soon as it lets Python run.
        ctypes.CDLL(None).prctl(_SET_DEATH_SIGNAL, signal.SIGKILL)

    def watch() -> None:
        os.read(parent, 1)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _main(task: str, parent: str) -> None:
    _end_with(int(parent))
    # What crashes here is expected to, and leaves no image of the memory in somebody's folder.
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # What native code prints is not mixed with the answer.
    answer = os.dup(sys.stdout.fileno())
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    with np.load(io.BytesIO(sys.stdin.buffer.read())) as arrays, os.fdopen(answer, "wb") as pipe:
        found = io.BytesIO()
        np.savez(found, **{"chart": chart, "pack": pack}[task](arrays))
        pipe.write(found.getvalue())


if __name__ == "__main__":
    _main(*sys.argv[1:])
