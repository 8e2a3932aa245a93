"""A texture atlas: the surface cut into charts, flattened and packed into one square image.

Charts and packing are xatlas's (J. Young, after I. Castaño's thekla_atlas; conformal maps after Lévy et al.
2002, "Least squares conformal maps"). It runs in a process of its own, with what it cannot take kept from it:
triangles without area, lengths far from 1, and, where it fails, charts that could close up.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import subprocess
import sys
import threading
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import StageError
from stages.progress import Progress, silent
from stages.surface.mesh import Mesh
from stages.surface.rasterize import overlaps
from stages.surface.texture import signed_areas
from stages.surface.topology import areas, is_degenerate

Floats = NDArray[np.float64]

# xatlas takes lengths near 1e-4 for none, and areas below 1e-7: edges are made this long.
_EDGE = 300.0
# A triangle with less than this share of the texels it should have is laid out on its own.
_LEAST_SHARE = 1e-3
# Charts are packed in an image of this side at most, which is then enlarged: packing takes time by the texel.
_PACKED = 1024
# How often what still overlaps is taken out of its chart.
_REPAIRS = 3
# Of the image's side, to begin with; packing finds out what fits.
_FIRST_FILLED = 0.8
# Seconds; a mesh of 100,000 triangles takes half a minute, a soup of as many loose ones far longer.
_PATIENCE, _PATIENCE_PER_TRIANGLE = 120.0, 0.01
_LOOK_EVERY = 0.02


@dataclass(frozen=True, eq=False)
class Atlas:
    """Where each triangle lies in the image.

    Attributes
    ----------
    corners : (m, 3, 2) float64, x and y in texels from the upper left corner of the image.
    charts : (m,) int64, the chart of each triangle; -1 for triangles without area, which have none.
    size : texels, of a side of the image.
    padding : texels around each chart that are its own, at least.
    """

    corners: Floats
    charts: NDArray[np.int64]
    size: int
    padding: int

    @property
    def uvs(self) -> Floats:
        """Return texture coordinates (m, 3, 2); (0, 0) is the lower left corner of the image."""
        return np.asarray(self.corners * (1, -1) / self.size + (0, 1))


def unwrap(mesh: Mesh, size: int, padding: int, progress: Progress = silent) -> Atlas:
    """Lay out a surface in a square image, as large as it fits; the same mesh gives the same atlas.

    Parameters
    ----------
    mesh : with some area. It need not be a manifold.
    size : texels, of a side of the image.
    padding : texels around each chart that are its own, at least.
    progress : called with 0 of 1 while this goes on; raising from it stops it.

    Raises
    ------
    StageError
        If the charts do not fit with their padding, or xatlas fails.
    """
    (proper,) = np.nonzero(~is_degenerate(mesh.vertices, mesh.triangles))
    area = areas(mesh.vertices, mesh.triangles[proper])
    scale = _EDGE / math.sqrt(area.sum() / len(area))
    placed = mesh.vertices[mesh.triangles[proper]]
    placed = (placed - (placed.min(axis=(0, 1)) + placed.max(axis=(0, 1))) / 2) * scale
    flat, charts = _charts(mesh.triangles[proper], placed, progress)
    enlarged = max(size / _PACKED, 1.0)
    side, apart = round(size / enlarged), math.ceil(padding / enlarged)
    density = _FIRST_FILLED * side / math.sqrt(np.abs(signed_areas(flat)).sum())
    packed: dict[str, NDArray[Any]] = {}
    for _ in range(1 + _REPAIRS):
        given = {"corners": flat, "charts": charts, "size": side, "padding": apart, "density": density}
        found = _asked("pack", given, progress)
        if found is None:
            raise _failure(len(proper))
        if not found:
            raise StageError(
                f"the charts of {len(proper):,} triangles do not fit in {size} × {size} texels with "
                f"{padding} around each; give a larger max_size or a smaller padding."
            )
        density = float(found["density"])
        packed = {"corners": found["corners"] * enlarged, "charts": charts}
        bad = overlaps(packed["corners"], size).triangles
        if not len(bad):
            break
        flat, charts = _apart(flat, charts, placed, bad)
    charts_of = np.full(len(mesh.triangles), -1, np.int64)
    corners = np.zeros((len(mesh.triangles), 3, 2))
    corners[proper], charts_of[proper] = packed["corners"], packed["charts"]
    _place_flat(mesh, corners, charts_of)
    return Atlas(corners, charts_of, size, padding)


def _charts(
    triangles: NDArray[np.int32], placed: Floats, progress: Progress
) -> tuple[Floats, NDArray[np.int64]]:
    """Return each triangle flattened (m, 3, 2), to the scale of `placed` (m, 3, 3), and its chart (m,)."""
    sides = placed[:, 1:] - placed[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2
    vertices = np.zeros((triangles.max() + 1, 3), np.float32)
    vertices[triangles] = placed
    given = {"vertices": vertices, "triangles": triangles.astype(np.uint32), "area": area.sum()}
    found = _asked("chart", given | {"groups": np.zeros(len(triangles), np.int64)}, progress)
    if found is None:
        # A surface that is smooth enough is one chart to it even if it is closed, and it crashes.
        found = _asked("chart", given | {"groups": _sides(placed)}, progress)
    if found is None:
        raise _failure(len(triangles))
    flat, charts = found["corners"], found["charts"]
    charts[charts < 0] = charts.max() + 1 + np.arange(np.count_nonzero(charts < 0))
    flat *= math.sqrt(area.sum() / np.abs(signed_areas(flat)).sum())
    # What lies on others in its chart, or has hardly any area in it.
    signed = signed_areas(flat)
    orientation = np.sign(np.bincount(charts, signed))[charts]
    (bad,) = np.nonzero(~(signed * orientation >= _LEAST_SHARE * area))
    return _apart(flat, charts, placed, bad)


def _apart(
    flat: Floats, charts: NDArray[np.int64], placed: Floats, bad: NDArray[np.int64]
) -> tuple[Floats, NDArray[np.int64]]:
    """Make a chart of its own of each bad triangle, in its true shape; charts are then counted anew."""
    flat, charts = flat.copy(), charts.copy()
    flat[bad] = _laid_out(placed[bad])
    charts[bad] = charts.max() + 1 + np.arange(len(bad))
    return flat, np.unique(charts, return_inverse=True)[1].reshape(-1).astype(np.int64)


def _laid_out(corners: Floats) -> Floats:
    """Return triangles (k, 3, 3) laid in a plane, (k, 3, 2), by their longest side."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    order = (lengths.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[:, :, None], axis=1).swapaxes(0, 1)
    base = np.linalg.norm(b - a, axis=1)
    along = ((c - a) * (b - a)).sum(axis=1) / base
    height = np.linalg.norm(np.cross(b - a, c - a), axis=1) / base
    zero = np.zeros_like(base)
    flat = np.stack([zero, zero, base, zero, along, height], axis=1).reshape(-1, 3, 2)
    return np.take_along_axis(flat, np.argsort(order, axis=1)[:, :, None], axis=1)


def _failure(count: int) -> StageError:
    return StageError(
        f"xatlas fails on this mesh of {count:,} triangles; `scanloom clean` takes out what it may stumble "
        "over."
    )


def _asked(task: str, given: Mapping[str, Any], progress: Progress) -> dict[str, NDArray[Any]] | None:
    """Have the worker do a task; None if it crashes.

    Raises
    ------
    StageError
        If it takes too long, or fails otherwise.
    """
    count = len(given["charts" if task == "pack" else "triangles"])
    packed = io.BytesIO()
    np.savez(packed, **given)
    found, said = _in_own_process(
        task, packed.getvalue(), _PATIENCE + _PATIENCE_PER_TRIANGLE * count, progress
    )
    if "No module named 'xatlas'" in said:
        raise StageError("the Python package xatlas is not installed: pip install xatlas")
    if "Error" in said:
        raise StageError(f"no atlas was found: {said.strip().splitlines()[-1]}")
    if found is None:
        return None
    with np.load(io.BytesIO(found)) as arrays:
        return dict(arrays)


def _in_own_process(task: str, given: bytes, patience: float, progress: Progress) -> tuple[bytes | None, str]:
    """Run the worker; return what it finds, or None if it crashes, and what it says on stderr if it fails.

    All goes through pipes: whatever happens to either process, no file stays behind.
    """
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    # Nothing is written to this pipe. Its other end closes when this process ends, however it does, and the
    # worker ends then too.
    ends, kept = os.pipe()
    try:
        worker = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("atlas_worker.py")), task, str(ends)],
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=(ends,),
        )
        with worker:
            try:
                found, said = _waited_for(worker, given, patience, progress)
            finally:
                worker.kill()  # Without effect on one that has ended.
    finally:
        os.close(ends)
        os.close(kept)
    return found if worker.returncode == 0 else None, said.decode(errors="replace")


def _waited_for(
    worker: subprocess.Popen[bytes], given: bytes, patience: float, progress: Progress
) -> tuple[bytes, bytes]:
    start = time.monotonic()
    # By a thread: `communicate` sends what fits into the pipe until its first timeout, and never the rest.
    threading.Thread(target=_send, args=(worker.stdin, given), daemon=True).start()
    worker.stdin = None
    while True:
        progress(0, 1)
        try:
            return worker.communicate(timeout=_LOOK_EVERY)
        except subprocess.TimeoutExpired:
            if time.monotonic() - start > patience:
                raise StageError(
                    f"xatlas has not found an atlas in {patience:.0f} s; simplify the mesh further, or "
                    "take out loose pieces with `scanloom clean`."
                ) from None


def _send(pipe: IO[bytes], given: bytes) -> None:
    # A worker that has ended takes nothing more.
    with contextlib.suppress(BrokenPipeError), pipe:
        pipe.write(given)


def _sides(corners: Floats) -> NDArray[np.int64]:
    """Return which of six directions each triangle (m, 3, 3) faces most: no group of them closes up."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normals).argmax(axis=1)
    return np.asarray(2 * axis + (normals[np.arange(len(axis)), axis] < 0), np.int64)


def _place_flat(mesh: Mesh, corners: Floats, charts: NDArray[np.int64]) -> None:
    """Put the corners of triangles without area where another triangle has the vertex, if one has."""
    (flat,) = np.nonzero(charts < 0)
    if not len(flat):
        return
    place = np.zeros((len(mesh.vertices), 2))
    place[mesh.triangles[charts >= 0]] = corners[charts >= 0]
    # All three at the first one's: they may be in different charts, with others in between.
    corners[flat] = place[mesh.triangles[flat, :1]]
