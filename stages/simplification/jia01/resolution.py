"""Default resolution of method `jia01`: an edge length at which splits and the length limit take effect."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.surface.mesh import Mesh

# Resolution, relative to the mean edge length of the input, weighted by length. The weights make it
# independent of how many tiny edges a mesh has. Chosen on a fused sample, a kitchen, a face and an aeroplane:
# a longer one makes edges less even, a shorter one costs triangles. The results are in docs/measured.md.
_PER_INPUT_EDGE = 1.33

# Minimum resolution, relative to the edge length of a mesh with the expected number of even triangles. Where
# bounds allow few triangles, a shorter length would be the bound.
_PER_EXPECTED_EDGE = 0.54

# Maximum ratio of triangles that splitting adds. It prevents a few long edges from determining the size of
# the mesh.
_MAX_SPLIT_RATIO = 0.5


def choose_resolution(mesh: Mesh, expected_triangles: int, threads: int) -> float:
    """Choose the resolution in metres.

    Parameters
    ----------
    mesh : mesh before simplification.
    expected_triangles : number of triangles after simplification, approximately.
    threads : 0 for one per core.
    """
    lengths = _kernels.compute_side_lengths(mesh.vertices, mesh.triangles, wanted_threads=threads)
    total = float(lengths.sum())
    if not total > 0:
        return 1.0  # no edge has a length; the value has no effect
    mean = float(np.square(lengths).sum()) / total
    expected_mean = mean * math.sqrt(len(lengths) / max(expected_triangles, 1))
    resolution = max(_PER_INPUT_EDGE * mean, _PER_EXPECTED_EDGE * expected_mean)
    while _count_split_triangles(lengths, resolution) > _MAX_SPLIT_RATIO * len(lengths):
        resolution *= 1.1
    return resolution


def _count_split_triangles(lengths: NDArray[np.float64], resolution: float) -> float:
    """Compute a lower bound on the triangles that splitting adds.

    Edges are halved until they are short enough; each cut adds one triangle.
    """
    pieces = np.exp2(np.ceil(np.log2(lengths[lengths > resolution] / resolution)))
    return float((pieces - 1).sum())
