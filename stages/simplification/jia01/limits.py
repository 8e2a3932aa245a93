"""The three limits of JIA01, and what they are where the user leaves them open."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh

# The defaults, found on a room fused at 2 cm and on a globe with a satellite map (see this package).
EDGES_PER_RESOLUTION = 36.0  # wanted edge length / mean edge length of the input
SHAPE_PER_RESOLUTION = 0.1  # the paper's choice
SHAPE_PER_DIAGONAL = 0.005  # a mesh of few large triangles must not lose its shape
MAX_COLOR = 400.0  # 8-bit levels, summed over the collapses around an edge

# By default, splitting may add this share of the triangles: a few long edges must not decide for all others.
_SPLIT_SHARE = 0.05


@dataclass(frozen=True)
class Limits:
    """L, S_max, T_max: as bounds (infinite for none) and as what the order of collapses is relative to."""

    bounds: tuple[float, float, float]
    scales: tuple[float, float, float]
    max_color: float
    attribute_scale: float


def limits_of(task: Task[Jia01Params]) -> Limits:
    """Complete the limits that were given; with a number of triangles, the others are no bounds."""
    mesh, only_given = task.mesh, task.triangles is not None
    given = (task.params.resolution, task.max_shape, task.max_color)
    resolution, max_shape, max_color = given
    if resolution is None:
        resolution = _default_resolution(mesh, task.threads)
    if max_shape is None:
        max_shape = _default_shape(mesh, resolution)
    if max_color is None:
        max_color = MAX_COLOR
    # No texture change at all is a fair wish; it then needs another unit in the order.
    color_scale = max_color or 1.0
    attribute_scale = task.attribute_scale
    if attribute_scale is None:
        attribute_scale = max_shape / color_scale
    bounds = (
        math.inf if only_given and wanted is None else value
        for value, wanted in zip((resolution, max_shape, max_color), given, strict=True)
    )
    return Limits(
        bounds=(next(bounds), next(bounds), next(bounds)),
        scales=(resolution, max_shape, color_scale),
        max_color=max_color,
        attribute_scale=attribute_scale,
    )


def _default_shape(mesh: Mesh, resolution: float) -> float:
    # A column at a time: reducing over rows of three is several times slower.
    extent = [np.ptp(column) for column in mesh.vertices.T] if len(mesh.vertices) else [0.0]
    diagonal = float(np.linalg.norm(extent))
    share = SHAPE_PER_RESOLUTION * resolution
    return min(share, SHAPE_PER_DIAGONAL * diagonal) if diagonal > 0 else share


def _default_resolution(mesh: Mesh, threads: int) -> float:
    """So many mean edge lengths, or more if that would split too many edges."""
    lengths = _kernels.side_lengths(mesh.vertices, mesh.triangles, wanted_threads=threads).ravel()
    resolution = EDGES_PER_RESOLUTION * float(lengths.mean()) if len(lengths) else 0.0
    if not resolution > 0:
        return 1.0  # no edge has a length; any will do
    while _split_triangles(lengths, resolution) > _SPLIT_SHARE * len(mesh.triangles):
        resolution *= 1.1
    return resolution


def _split_triangles(lengths: NDArray[np.float64], resolution: float) -> float:
    """Triangles that splitting adds at least: sides are halved until short enough, each cut adds one."""
    pieces = np.exp2(np.ceil(np.log2(lengths[lengths > resolution] / resolution)))
    return float((pieces - 1).sum())
