"""Limits of method `jia01`, with defaults derived from the mesh."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from scanloom.stages import _kernels
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.task import Task
from scanloom.stages.surface.mesh import Mesh

MAX_SHAPE_PER_RESOLUTION = 0.1  # the paper's value, for a given resolution
# At the default resolution, the paper's value is below the noise of scans, and would keep half of their
# triangles.
MAX_SHAPE_PER_MEAN_EDGE = 3.6
MAX_SHAPE_PER_DIAGONAL = 0.005  # preserves the shape of meshes with few large triangles
MAX_COLOR = 700.0  # 8-bit levels, accumulated over the collapses around an edge


@dataclass(frozen=True)
class Jia01Limits:
    """Limits L, S_max and T_max of the paper.

    Attributes
    ----------
    bounds : (L, S_max, T_max) as bounds, infinite where unbounded; metres, metres, levels.
    scales : (L, S_max, T_max) as normalisation of the collapse order.
    max_color : levels, T_max as given or by default.
    attribute_scale : metres per level.
    soft_length : True if edges longer than L are split, but may collapse after all others.
    """

    bounds: tuple[float, float, float]
    scales: tuple[float, float, float]
    max_color: float
    attribute_scale: float
    soft_length: bool = False

    def with_resolution(self, resolution: float, *, soft: bool) -> Jia01Limits:
        """Return a copy with another resolution in metres."""
        return replace(
            self,
            bounds=(resolution, *self.bounds[1:]),
            scales=(resolution, *self.scales[1:]),
            soft_length=soft,
        )


def resolve_limits(task: Task[Jia01Params]) -> Jia01Limits:
    """Complete the given limits by defaults, except the resolution.

    Without a given resolution, or with an infinite one, the length of edges is unbounded. With a triangle
    count, limits of shape and colour that were not given are infinite bounds, too.
    """
    mesh, only_given = task.mesh, task.triangles is not None
    resolution = None if task.params.resolution == math.inf else task.params.resolution
    max_shape, max_color = task.max_shape, task.max_color
    if max_shape is None:
        max_shape = _compute_default_shape(mesh, resolution, task.threads)
    if max_color is None:
        max_color = MAX_COLOR
    # A bound of 0 allows no texture change; the collapse order then needs another unit.
    color_scale = max_color or 1.0
    attribute_scale = task.attribute_scale
    if attribute_scale is None:
        attribute_scale = max_shape / color_scale
    return Jia01Limits(
        bounds=(
            math.inf if resolution is None else resolution,
            math.inf if only_given and task.max_shape is None else max_shape,
            math.inf if only_given and task.max_color is None else max_color,
        ),
        scales=(
            (_compute_diagonal(mesh) or 1.0) if resolution is None else resolution,
            max_shape,
            color_scale,
        ),
        max_color=max_color,
        attribute_scale=attribute_scale,
    )


def _compute_default_shape(mesh: Mesh, resolution: float | None, threads: int) -> float:
    diagonal = _compute_diagonal(mesh)
    if resolution is None:
        lengths = _kernels.compute_side_lengths(mesh.vertices, mesh.triangles, wanted_threads=threads)
        share = MAX_SHAPE_PER_MEAN_EDGE * float(lengths.mean()) if lengths.size else 0.0
    else:
        share = MAX_SHAPE_PER_RESOLUTION * resolution
    found = min(share, MAX_SHAPE_PER_DIAGONAL * diagonal) if diagonal > 0 else share
    return found if found > 0 else 1.0  # no edge has a length; the value has no effect


def _compute_diagonal(mesh: Mesh) -> float:
    # Column by column, because `ptp` over rows of three is several times slower.
    extent = [np.ptp(column) for column in mesh.vertices.T] if len(mesh.vertices) else [0.0]
    return float(np.linalg.norm(extent))
