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

from scanloom.stages.comparing.needle_search import NeedleSafeSurface
from scanloom.stages.comparing.signed_distance import Pseudonormals, build_pseudonormals
from scanloom.stages.comparing.surface_sampling import sample_stratified
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.surface.point_cloud import is_cloud
from scanloom.stages.surface.raycasting import Floats, RaycastingSurface, interpolate_values, iterate_chunks
from scanloom.stages.surface.surface_color import compute_surface_colors, has_color
from scanloom.stages.surface.topology import compute_areas

Levels = NDArray[np.floating]
# Relative tolerance (`eps`) of nearest-point queries on a cloud. An exact query takes minutes for a distant
# cloud, where many points are almost equally near.
_QUERY_TOLERANCE = 1e-6
# Maximum number of points sampled to measure the spacing of a cloud.
_MAX_SPACING_SAMPLES = 50_000


@dataclass(frozen=True, eq=False)
class SamplePoints:
    """Sample points (k, 3) in metres, and their colours (k, 3) in levels if requested."""

    positions: Floats
    colors: Levels | None


@dataclass(frozen=True, eq=False)
class NearestPoints:
    """Nearest points of a target to k query points.

    Attributes
    ----------
    distances : (k,) metres. If signs were requested and the target is oriented, negative behind the surface.
    colors : (k, 3) levels at the nearest points; None if not requested.
    """

    distances: Floats
    colors: Levels | None


class SampledSurface(Protocol):
    """Surface or cloud that sample points can be drawn from."""

    @property
    def has_color(self) -> bool:
        """True if the mesh or cloud has colours."""

    def count_samples(self, requested: int) -> int:
        """Return the number of points that `draw_points` draws when `requested` are requested."""

    def draw_points(
        self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool
    ) -> SamplePoints:
        """Return rows `rows` of `count` evenly distributed sample points."""

    def iterate_extra_points(self, *, colored: bool) -> Iterator[SamplePoints]:
        """Yield additional points that count only for the maximum distance."""


class DistanceTarget(SampledSurface, Protocol):
    """Mesh or cloud that distances are measured to."""

    mesh: Mesh

    @property
    def is_oriented(self) -> bool:
        """True if the target has a front side, which distance signs require."""

    @property
    def spacing(self) -> float | None:
        """Median spacing of a cloud's points in metres; None for a mesh."""

    def find_nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> NearestPoints:
        """Return the nearest points of the target to `points` (k, 3)."""


def make_distance_target(mesh: Mesh, box: Floats, surface: NeedleSafeSurface | None = None) -> DistanceTarget:
    """Build the distance target for a mesh or cloud.

    Parameters
    ----------
    mesh : mesh or cloud returned by `to_mesh_or_cloud`.
    box : (2, 3) minimum and maximum corner of all geometry involved in queries.
    surface : existing search structure of the mesh, built for this box; None to build one on first use.
    """
    return _CloudTarget(mesh) if is_cloud(mesh) else _MeshTarget(mesh, box, surface)


class _MeshTarget:
    """Mesh as distance target, sampled evenly over its area.

    Its vertices count for the maximum, because simplified surfaces deviate most at vertices.
    """

    def __init__(self, mesh: Mesh, box: Floats, searched: NeedleSafeSurface | None) -> None:
        self.mesh = mesh
        self._box, self._given_surface = box, searched

    @cached_property
    def _search_surface(self) -> NeedleSafeSurface:
        return self._given_surface or NeedleSafeSurface(RaycastingSurface(self.mesh, self._box), self._box)

    @cached_property
    def _pseudonormals(self) -> Pseudonormals | None:
        return build_pseudonormals(self.mesh)

    @cached_property
    def _cumulative_areas(self) -> Floats:
        return np.cumsum(compute_areas(self.mesh.vertices, self.mesh.triangles))

    @property
    def has_color(self) -> bool:
        return has_color(self.mesh)

    @property
    def is_oriented(self) -> bool:
        return self._pseudonormals is not None

    @property
    def spacing(self) -> None:
        return None

    def count_samples(self, requested: int) -> int:
        return requested

    def draw_points(
        self, rows: slice, count: int, rng: np.random.Generator, *, colored: bool
    ) -> SamplePoints:
        at = sample_stratified(self._cumulative_areas, rows, count, rng)
        colors = compute_surface_colors(self.mesh, at.triangles, at.weights) if colored else None
        return SamplePoints(interpolate_values(self.mesh.vertices, self.mesh, at), colors)

    def iterate_extra_points(self, *, colored: bool) -> Iterator[SamplePoints]:
        return iterate_used_vertices(self.mesh, colored=colored)

    def find_nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> NearestPoints:
        found = self._search_surface.find_closest_points(points)
        colors = compute_surface_colors(self.mesh, found.triangles, found.weights) if colored else None
        if signed and self._pseudonormals is not None:
            return NearestPoints(found.distances * self._pseudonormals.compute_signs(points, found), colors)
        return NearestPoints(found.distances, colors)


def iterate_used_vertices(mesh: Mesh, *, colored: bool) -> Iterator[SamplePoints]:
    """Yield the vertices of a mesh that triangles use, in chunks."""
    # Along a texture seam a vertex has several colours; only the first corner's colour is compared.
    used, corners = np.unique(mesh.triangles, return_index=True)
    for rows in iterate_chunks(len(used)):
        colors = None
        if colored:
            colors = compute_surface_colors(mesh, corners[rows] // 3, np.eye(3)[corners[rows] % 3])
        yield SamplePoints(mesh.vertices[used[rows]], colors)


class _CloudTarget:
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
        if len(points) > _MAX_SPACING_SAMPLES:
            points = points[np.random.default_rng(0).choice(len(points), _MAX_SPACING_SAMPLES, replace=False)]
        distances = self._tree.query(points, 2, workers=-1)[0][:, 1]
        # Duplicate points have distance 0 and are excluded from the spacing.
        return float(np.median(distances[distances > 0])) if distances.any() else 0.0

    def count_samples(self, requested: int) -> int:  # noqa: ARG002
        return len(self.mesh.vertices)

    def draw_points(
        self,
        rows: slice,
        count: int,  # noqa: ARG002
        rng: np.random.Generator,  # noqa: ARG002
        *,
        colored: bool,
    ) -> SamplePoints:
        colors = None
        if colored and self.mesh.colors is not None:
            colors = self.mesh.colors[rows].astype(np.float64)
        return SamplePoints(self.mesh.vertices[rows], colors)

    def iterate_extra_points(self, *, colored: bool) -> Iterator[SamplePoints]:  # noqa: ARG002
        return iter(())

    def find_nearest(self, points: Floats, *, colored: bool = False, signed: bool = False) -> NearestPoints:
        distances, rows = self._tree.query(points, eps=_QUERY_TOLERANCE, workers=-1)
        colors = None
        if colored and self.mesh.colors is not None:
            colors = self.mesh.colors[rows].astype(np.float64)
        if signed and self.is_oriented and self.mesh.normals is not None:
            away = points - self.mesh.vertices[rows]
            is_behind = np.einsum("kx,kx->k", away, self.mesh.normals[rows]) < 0
            distances = np.where(is_behind, -distances, distances)
        return NearestPoints(distances, colors)
