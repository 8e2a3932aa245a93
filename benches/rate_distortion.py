"""Bytes against distance: files of one mesh, which of them are worth having, and how two coders compare."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from scanloom.stages.comparing.compare import CompareParams, compare_surfaces
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Surface, bounding_box

# A coder's result may reach beyond the original's box by this share of it.
MARGIN = 0.02


@dataclass(frozen=True)
class File:
    """One file of a mesh.

    Attributes
    ----------
    size : bytes.
    rms : distance to the original, over the diagonal of its box; the larger of the two directions.
    made : how, for the table.
    """

    size: int
    rms: float
    made: str

    @property
    def decibels(self) -> float:
        """Return 20 log10(diagonal / RMS), as papers on geometry coding give it."""
        return -20 * math.log10(self.rms)


class Original:
    """A mesh that many results are measured against."""

    def __init__(self, mesh: Mesh, samples: int) -> None:
        box = bounding_box(mesh)
        self.mesh = mesh
        self._params = CompareParams(samples=samples)
        self._box = box + MARGIN * (box[1] - box[0]) * [[-1], [1]]
        self._surface = Surface(mesh, self._box)

    def file(self, size: int, result: Mesh, made: str) -> File:
        """Measure what a file of so many bytes holds."""
        found = compare_surfaces(self._surface, Surface(result, self._box), self._params)
        return File(size, max(found.a_to_b.rms, found.b_to_a.rms) / found.diagonal, made)


def frontier(files: Iterable[File]) -> list[File]:
    """Return the files that no other one is both smaller and nearer than, smallest first."""
    best: list[File] = []
    for file in sorted(files, key=lambda file: (file.size, file.rms)):
        if not best or file.rms < best[-1].rms:
            best.append(file)
    return best


def smallest(files: list[File], rms: float) -> File | None:
    """Return the smallest file of a frontier that is at least as near as `rms`; None if there is none."""
    return next((file for file in files if file.rms <= rms), None)


def size_at(files: list[File], rms: float) -> float | None:
    """Return the bytes a coder would need for `rms`, between the two files of its frontier next to it.

    Logarithms are interpolated linearly, so a rival gets the benefit of files it was not asked for. None
    outside the frontier's range.
    """
    nearer = bisect.bisect_left(files, -rms, key=lambda file: -file.rms)
    if nearer == len(files) or (nearer == 0 and files[0].rms < rms):
        return None
    if files[nearer].rms == rms:
        return float(files[nearer].size)
    coarse, fine = files[nearer - 1], files[nearer]
    known = np.log([fine.rms, coarse.rms])
    return float(np.exp(np.interp(math.log(rms), known, np.log([fine.size, coarse.size]))))
