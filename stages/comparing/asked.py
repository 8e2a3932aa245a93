"""Common interface of meshes and point clouds for distance measurements.

It offers sample points and nearest-point queries. The nearest point of a mesh can be anywhere on a triangle.
The nearest point of a cloud is one of its points, so distances to a cloud are limited by its point spacing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.comparing.needles import WithNeedles
from scanloom.stages.comparing.sampling import sampled
from scanloom.stages.comparing.signed import Sides, sides_of
from scanloom.stages.surface.cloud import is_cloud
from scanloom.stages.surface.color import color_at, has_color
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.raycasting import Floats, Surface, chunks, interpolated
from scanloom.stages.surface.topology import areas

Levels = NDArray[np.floating]
# Relative tolerance (`eps`) of nearest-point queries on a cloud. An exact query takes minutes for a distant
# cloud, where many points are almost equally near.
_ALIKE = 1e-6
# Maximum number of points sampled to measure the spacing of a cloud.
_SPACING_AT = 50_000


@dataclass(frozen=True, eq=False)
class Points:
    """Sample points (k, 3) in metres, and their colours (k, 3) in levels if requested."""

    places: Floats
    colors: Levels | None


@dataclass(frozen=True, eq=False)
class Nearest:
    """Nearest points of a target to k query points.

    Attributes
    ----------
    distances : (k,) metres. If signs were requested and the target is oriented, negative behind the surface.
    colors : (k, 3) levels at the nearest points; None if not requested.
    """

    distances: Floats
    colors: Levels | None


class Spread(Protocol):
    """Surface or cloud that sample points can be drawn from."""

    @property
    def has_color(self) -> bool:
        """True if the mesh or cloud has colours."""

    def samples(self, wanted: int) -> int:
        """Return the number of points that `spread` draws when `wanted` are requested."""

    def spread(self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool) -> Points:
        """Return rows `rows` of `count` evenly distributed sample points."""

    def corners(self, *, colored: bool) -> Iterator[Points]:
        """Yield additional points that count only for the maximum distance."""


class Asked(Spread, Protocol):
    """Mesh or cloud that distances are measured to."""

    mesh: Mesh

    @property
    def is_oriented(self) -> bool:
        """True if the target has a front side, which distance signs require."""

    @property
    def spacing(self) -> float | None:
        """Median spacing of a cloud's points in metres; None for a mesh."""

    def nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> Nearest:
        """Return the nearest points of the target to `points` (k, 3)."""


def asked(mesh: Mesh, box: Floats, searched: WithNeedles | None = None) -> Asked:
    """Build the distance target for a mesh or cloud.

    Parameters
    ----------
    mesh : mesh or cloud returned by `comparable`.
    box : (2, 3) minimum and maximum corner of all geometry involved in queries.
    searched : existing search structure of the mesh, built for this box; None to build one on first use.
    """
    return _Cloud(mesh) if is_cloud(mesh) else _Surface(mesh, box, searched)


class _Surface:
    """Mesh as distance target, sampled evenly over its area.

    Its vertices count for the maximum, because simplified surfaces deviate most at vertices.
    """

    def __init__(self, mesh: Mesh, box: Floats, searched: WithNeedles | None) -> None:
        self.mesh = mesh
        self._box, self._given = box, searched

    @cached_property
    def _searched(self) -> WithNeedles:
        return self._given or WithNeedles(Surface(self.mesh, self._box), self._box)

    @cached_property
    def _sides(self) -> Sides | None:
        return sides_of(self.mesh)

    @cached_property
    def _cumulative(self) -> Floats:
        return np.cumsum(areas(self.mesh.vertices, self.mesh.triangles))

    @property
    def has_color(self) -> bool:
        return has_color(self.mesh)

    @property
    def is_oriented(self) -> bool:
        return self._sides is not None

    @property
    def spacing(self) -> None:
        return None

    def samples(self, wanted: int) -> int:
        return wanted

    def spread(self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool) -> Points:
        at = sampled(self._cumulative, rows, count, rng)
        colors = color_at(self.mesh, at.triangles, at.weights) if colored else None
        return Points(interpolated(self.mesh.vertices, self.mesh, at), colors)

    def corners(self, *, colored: bool) -> Iterator[Points]:
        return corners_of(self.mesh, colored=colored)

    def nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> Nearest:
        found = self._searched.closest(points)
        colors = color_at(self.mesh, found.triangles, found.weights) if colored else None
        if signed and self._sides is not None:
            return Nearest(found.distances * self._sides.signs(points, found), colors)
        return Nearest(found.distances, colors)


def corners_of(mesh: Mesh, *, colored: bool) -> Iterator[Points]:
    """Yield the vertices of a mesh that triangles use, in chunks."""
    # Along a texture seam a vertex has several colours; only the first corner's colour is compared.
    used, corners = np.unique(mesh.triangles, return_index=True)
    for rows in chunks(len(used)):
        colors = None
        if colored:
            colors = color_at(mesh, corners[rows] // 3, np.eye(3)[corners[rows] % 3])
        yield Points(mesh.vertices[used[rows]], colors)


class _Cloud:
    """Point cloud as distance target; every point is a sample."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self.mesh = mesh
        # Scans are dense and even enough for midpoint splits, which build faster than median splits.
        self._tree = cKDTree(mesh.vertices, balanced_tree=False)

    @property
    def has_color(self) -> bool:
        return has_color(self.mesh)

    @cached_property
    def is_oriented(self) -> bool:
        return self.mesh.normals is not None and bool(self.mesh.normals.any(axis=1).all())

    @cached_property
    def spacing(self) -> float:
        points = self.mesh.vertices
        if len(points) > _SPACING_AT:
            points = points[np.random.default_rng(0).choice(len(points), _SPACING_AT, replace=False)]
        distances = self._tree.query(points, 2, workers=-1)[0][:, 1]
        # Duplicate points have distance 0 and are excluded from the spacing.
        return float(np.median(distances[distances > 0])) if distances.any() else 0.0

    def samples(self, wanted: int) -> int:  # noqa: ARG002
        return len(self.mesh.vertices)

    def spread(self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool) -> Points:  # noqa: ARG002
        colors = None
        if colored and self.mesh.colors is not None:
            colors = self.mesh.colors[rows].astype(np.float64)
        return Points(self.mesh.vertices[rows], colors)

    def corners(self, *, colored: bool) -> Iterator[Points]:  # noqa: ARG002
        return iter(())

    def nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> Nearest:
        distances, rows = self._tree.query(points, eps=_ALIKE, workers=-1)
        colors = None
        if colored and self.mesh.colors is not None:
            colors = self.mesh.colors[rows].astype(np.float64)
        if signed and self.is_oriented and self.mesh.normals is not None:
            away = points - self.mesh.vertices[rows]
            is_behind = np.einsum("kx,kx->k", away, self.mesh.normals[rows]) < 0
            distances = np.where(is_behind, -distances, distances)
        return Nearest(distances, colors)
