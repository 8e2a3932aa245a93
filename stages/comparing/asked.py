"""A surface or a cloud, of which the same is asked: points of it, and what of it is nearest to other points.

Distances to a surface are to its nearest point, wherever that lies on a triangle. Distances to a cloud are to
its nearest point, so they are never less than the gaps between its points let them be.
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
# Points of a cloud whose distances differ by less than this share count as equally near: where a cloud is far
# off that is true of many of its points, and to tell them apart takes minutes.
_ALIKE = 1e-6
# Points that the spacing of a cloud is measured at.
_SPACING_AT = 50_000


@dataclass(frozen=True, eq=False)
class Points:
    """Some points (k, 3), metres, and their colours (k, 3), levels, if these were asked for."""

    places: Floats
    colors: Levels | None


@dataclass(frozen=True, eq=False)
class Nearest:
    """What is nearest to some points.

    Attributes
    ----------
    distances : (k,) metres; negative behind what is oriented, if signs were asked for.
    colors : (k, 3) levels there, if these were asked for.
    """

    distances: Floats
    colors: Levels | None


class Spread(Protocol):
    """What points can be had of."""

    @property
    def has_color(self) -> bool:
        """Whether it has colours."""

    def samples(self, wanted: int) -> int:
        """Return how many points `spread` has, if so many are wanted."""

    def spread(self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool) -> Points:
        """Return rows of `count` points that stand for all of it."""

    def corners(self, *, colored: bool) -> Iterator[Points]:
        """Yield further points, which count for what is farthest off alone."""


class Asked(Spread, Protocol):
    """What can be asked of both."""

    mesh: Mesh

    @property
    def is_oriented(self) -> bool:
        """Whether there is a side that it looks to."""

    @property
    def spacing(self) -> float | None:
        """Metres from points of a cloud to their nearest neighbours, the median; None of a surface."""

    def nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> Nearest:
        """Return what is nearest to points (k, 3)."""


def asked(mesh: Mesh, box: Floats, searched: WithNeedles | None = None) -> Asked:
    """Return a mesh or cloud ready to be asked.

    Parameters
    ----------
    mesh : that `comparable` returned.
    box : (2, 3) lowest and highest corner of everything that will be asked.
    searched : the mesh's surface, in this box, if there is one already.
    """
    return _Cloud(mesh) if is_cloud(mesh) else _Surface(mesh, box, searched)


class _Surface:
    """A mesh: its points are spread evenly over its area, and its vertices stray most."""

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
    """Yield the vertices of a mesh that a triangle uses."""
    # A corner of each: along a seam of a texture it has several colours; one is looked at.
    used, corners = np.unique(mesh.triangles, return_index=True)
    for rows in chunks(len(used)):
        colors = None
        if colored:
            colors = color_at(mesh, corners[rows] // 3, np.eye(3)[corners[rows] % 3])
        yield Points(mesh.vertices[used[rows]], colors)


class _Cloud:
    """A cloud: every point of it counts once."""

    def __init__(self, mesh: Mesh) -> None:
        from scipy.spatial import cKDTree

        self.mesh = mesh
        # Scanners spread points evenly enough for halves of space, which are found sooner than medians.
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
        # A point that is there twice says nothing of the gaps between points.
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
