"""Limits of method `jia01`, with defaults derived from the mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanloom.stages import _kernels
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh

# Defaults tuned on a room fused at 2 cm and on a sphere with a satellite map; the results are in the
# docstring of the package.
RESOLUTION_PER_MEAN_EDGE = 36.0  # target edge length / mean edge length of the input
MAX_SHAPE_PER_RESOLUTION = 0.1  # the paper's value
MAX_SHAPE_PER_DIAGONAL = 0.005  # preserves the shape of meshes with few large triangles
MAX_COLOR = 400.0  # 8-bit levels, accumulated over the collapses around an edge

# Maximum ratio of triangles that splitting adds by default. It prevents a few long edges from determining the
# resolution.
_MAX_SPLIT_RATIO = 0.05


@dataclass(frozen=True)
class Jia01Limits:
    """Limits L, S_max and T_max of the paper.

    Attributes
    ----------
    bounds : (L, S_max, T_max) as bounds, infinite where unbounded; metres, metres, levels.
    scales : (L, S_max, T_max) as normalisation of the collapse order.
    max_color : levels, T_max as given or by default.
    attribute_scale : metres per level.
    """

    bounds: tuple[float, float, float]
    scales: tuple[float, float, float]
    max_color: float
    attribute_scale: float


def resolve_limits(task: Task[Jia01Params]) -> Jia01Limits:
    """Complete the given limits by defaults.

    With a triangle count, limits that were not given are infinite bounds.
    """
    mesh, only_given = task.mesh, task.triangles is not None
    given = (task.params.resolution, task.max_shape, task.max_color)
    resolution, max_shape, max_color = given
    if resolution is None:
        resolution = _compute_default_resolution(mesh, task.threads)
    if max_shape is None:
        max_shape = _compute_default_shape(mesh, resolution)
    if max_color is None:
        max_color = MAX_COLOR
    # A bound of 0 allows no texture change; the collapse order then needs another unit.
    color_scale = max_color or 1.0
    attribute_scale = task.attribute_scale
    if attribute_scale is None:
        attribute_scale = max_shape / color_scale
    bounds = (
        math.inf if only_given and wanted is None else value
        for value, wanted in zip((resolution, max_shape, max_color), given, strict=True)
    )
    return Jia01Limits(
        bounds=(next(bounds), next(bounds), next(bounds)),
        scales=(resolution, max_shape, color_scale),
        max_color=max_color,
        attribute_scale=attribute_scale,
    )


def _compute_default_shape(mesh: Mesh, resolution: float) -> float:
    # Column by column, because `ptp` over rows of three is several times slower.
    extent = [np.ptp(column) for column in mesh.vertices.T] if len(mesh.vertices) else [0.0]
    diagonal = float(np.linalg.norm(extent))
    share = MAX_SHAPE_PER_RESOLUTION * resolution
    return min(share, MAX_SHAPE_PER_DIAGONAL * diagonal) if diagonal > 0 else share


def _compute_default_resolution(mesh: Mesh, threads: int) -> float:
    """Derive the resolution (m) from the mean edge length.

    It is increased until splitting adds few triangles.
    """
    lengths = _kernels.compute_side_lengths(mesh.vertices, mesh.triangles, wanted_threads=threads).ravel()
    resolution = RESOLUTION_PER_MEAN_EDGE * float(lengths.mean()) if len(lengths) else 0.0
    if not resolution > 0:
        return 1.0  # no edge has a length; the value has no effect
    while _count_split_triangles(lengths, resolution) > _MAX_SPLIT_RATIO * len(mesh.triangles):
        resolution *= 1.1
    return resolution


def _count_split_triangles(lengths: NDArray[np.float64], resolution: float) -> float:
    """Compute a lower bound on the triangles that splitting adds.

    Edges are halved until they are short enough; each cut adds one triangle.
    """
    pieces = np.exp2(np.ceil(np.log2(lengths[lengths > resolution] / resolution)))
    return float((pieces - 1).sum())
