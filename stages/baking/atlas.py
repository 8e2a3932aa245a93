"""A texture atlas: the surface cut into charts, flattened and packed into one square image.

Charts and packing are xatlas's (J. Young, after I. Castaño's thekla_atlas; conformal maps after Lévy et al.
2002, "Least squares conformal maps"). It runs in a process of its own, with what it cannot take kept from it:
triangles without area, lengths far from 1, and, where it fails, charts that could close up.
"""

from __future__ import annotations

import math
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stages.errors import StageError
from stages.mesh import Mesh
from stages.progress import Progress, silent
from stages.topology import areas, is_degenerate

Floats = NDArray[np.float64]

# xatlas takes lengths near 1e-4 for none, and areas below 1e-7: edges are made this long.
_EDGE = 300.0
# Seconds; a mesh of 100,000 triangles takes half a minute, a soup of as many loose ones far longer.
_PATIENCE, _PATIENCE_PER_TRIANGLE = 120.0, 0.01
_LOOK_EVERY = 0.05


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
    charts = np.full(len(mesh.triangles), -1, np.int64)
    corners = np.zeros((len(mesh.triangles), 3, 2))
    surface = Mesh(mesh.vertices, mesh.triangles[proper])
    one = np.zeros(len(proper), np.int64)
    found = _run(surface, one, size, padding, progress)
    if found is None:
        # A surface that is smooth enough is one chart to it even if it is closed, and it crashes.
        found = _run(surface, _sides(surface), size, padding, progress)
    if found is None:
        raise StageError(
            f"xatlas fails on this mesh of {len(proper):,} triangles; `scanloom clean` takes out what it may "
            "stumble over."
        )
    corners[proper], charts[proper] = found
    _place_flat(mesh, corners, charts)
    return Atlas(corners, charts, size, padding)


def _run(
    mesh: Mesh, groups: NDArray[np.int64], size: int, padding: int, progress: Progress
) -> tuple[Floats, NDArray[np.int64]] | None:
    """Run xatlas on triangles that all have an area; None if it crashes.

    Raises
    ------
    StageError
        If the charts do not fit, or it takes too long.
    """
    area = areas(mesh.vertices, mesh.triangles)
    scale = _EDGE / math.sqrt(area.sum() / len(area))
    low, high = mesh.vertices[mesh.triangles].min(axis=(0, 1)), mesh.vertices[mesh.triangles].max(axis=(0, 1))
    with tempfile.TemporaryDirectory(prefix="scanloom-atlas-") as folder:
        given, found = Path(folder, "given.npz"), Path(folder, "found.npz")
        np.savez(
            given,
            vertices=((mesh.vertices - (low + high) / 2) * scale).astype(np.float32),
            triangles=mesh.triangles.astype(np.uint32),
            groups=groups,
            size=size,
            padding=padding,
        )
        patience = _PATIENCE + _PATIENCE_PER_TRIANGLE * len(area)
        said = _in_own_process([str(given), str(found)], folder, patience, progress)
        if "do not fit" in said:
            raise StageError(
                f"the charts of {len(area):,} triangles do not fit in {size} × {size} texels with {padding} "
                "around each; give a larger max_size or a smaller padding."
            )
        if "No module named 'xatlas'" in said:
            raise StageError("the Python package xatlas is not installed: pip install xatlas")
        if "Error" in said:
            raise StageError(f"no atlas was found: {said.strip().splitlines()[-1]}")
        if not found.exists():
            return None
        with np.load(found) as arrays:
            return arrays["uvs"], arrays["charts"]


def _in_own_process(arguments: list[str], folder: str, patience: float, progress: Progress) -> str:
    """Run the worker and return what it says on stderr, which is something only if it fails."""
    path = os.pathsep.join(str(Path(entry).absolute()) for entry in sys.path)
    errors = Path(folder, "errors.txt")
    command = [sys.executable, "-m", "stages.baking.atlas_worker", *arguments]
    with errors.open("wb") as stderr:
        worker = subprocess.Popen(
            command,
            cwd=folder,
            env=os.environ | {"PYTHONPATH": path},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=stderr,
        )
        start = time.monotonic()
        try:
            while worker.poll() is None:
                progress(0, 1)
                if time.monotonic() - start > patience:
                    raise StageError(
                        f"xatlas has not found an atlas in {patience:.0f} s; simplify the mesh further, or "
                        "take out loose pieces with `scanloom clean`."
                    )
                time.sleep(_LOOK_EVERY)
        finally:
            if worker.poll() is None:
                worker.kill()
            worker.wait()
    return errors.read_text(errors="replace")


def _sides(mesh: Mesh) -> NDArray[np.int64]:
    """Return which of six directions each triangle faces most: no group of them closes up."""
    corners = mesh.vertices[mesh.triangles]
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
