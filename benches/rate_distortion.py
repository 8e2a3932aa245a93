"""Rate–distortion comparison of mesh coders."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from scanloom.stages.comparing.compare import CompareParams, compare_surfaces
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import RaycastingSurface, compute_bounding_box

# Enlarges the original's bounding box on each side, relative to its size, because a coder's result may exceed
# the box.
MARGIN = 0.02


@dataclass(frozen=True)
class EncodedMesh:
    """Encoded file of a mesh.

    Attributes
    ----------
    size : bytes.
    rms : RMS distance to the original over the diagonal of its box, the larger of the two directions.
    made : description of the parameters for the table.
    """

    size: int
    rms: float
    made: str

    @property
    def decibels(self) -> float:
        """20 log10(diagonal / RMS), as papers on geometry coding report it."""
        return -20 * math.log10(self.rms)


class ReferenceMesh:
    """Reference mesh for measuring many results."""

    def __init__(self, mesh: Mesh, samples: int) -> None:
        box = compute_bounding_box(mesh)
        self.mesh = mesh
        self._params = CompareParams(samples=samples)
        self._box = box + MARGIN * (box[1] - box[0]) * [[-1], [1]]
        self._surface = RaycastingSurface(mesh, self._box)

    def file(self, size: int, result: Mesh, made: str) -> EncodedMesh:
        """Measure the mesh that a file of `size` bytes decodes to."""
        found = compare_surfaces(self._surface, RaycastingSurface(result, self._box), self._params)
        return EncodedMesh(size, max(found.a_to_b.rms, found.b_to_a.rms) / found.diagonal, made)


def select_pareto_front(files: Iterable[EncodedMesh]) -> list[EncodedMesh]:
    """Select the Pareto-optimal files in size and RMS, smallest first."""
    best: list[EncodedMesh] = []
    for file in sorted(files, key=lambda file: (file.size, file.rms)):
        if not best or file.rms < best[-1].rms:
            best.append(file)
    return best


def find_smallest(files: list[EncodedMesh], rms: float) -> EncodedMesh | None:
    """Find the smallest file of a Pareto front whose RMS error is within a limit."""
    return next((file for file in files if file.rms <= rms), None)


def interpolate_size(files: list[EncodedMesh], rms: float) -> float | None:
    """Interpolate the size (bytes) that a coder needs for an RMS.

    Interpolates logarithms linearly between neighbouring files of its Pareto front. This favours the rival,
    because no file of that size has to exist. Returns None outside the front's range.
    """
    nearer = bisect.bisect_left(files, -rms, key=lambda file: -file.rms)
    if nearer == len(files) or (nearer == 0 and files[0].rms < rms):
        return None
    if files[nearer].rms == rms:
        return float(files[nearer].size)
    coarse, fine = files[nearer - 1], files[nearer]
    known = np.log([fine.rms, coarse.rms])
    return float(np.exp(np.interp(math.log(rms), known, np.log([fine.size, coarse.size]))))
