"""Locked vertices and importance, given per vertex or by regions in space."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.codes import USAGE_REGION_INVALID
from scanloom.stages.surface.mesh import Mesh

_REGION_FORMS = (
    '"sphere x y z radius ..." or "box x y z x y z ...", with an importance, "lock" or both at the end'
)


@dataclass(frozen=True, kw_only=True)
class _Region:
    importance: float | None = None
    lock: bool = False

    def _check_effect(self) -> None:
        if self.importance is None and not self.lock:
            raise UsageError(
                USAGE_REGION_INVALID,
                "{self} has no effect",
                remedy="give it an importance, or lock it.",
                self=self,
            )
        if self.importance is not None and not (0 < self.importance < math.inf):
            raise UsageError(
                USAGE_REGION_INVALID, "{self}: an importance must be above 0 and finite.", self=self
            )


@dataclass(frozen=True)
class Sphere(_Region):
    """Region of all vertices inside a sphere.

    Attributes
    ----------
    center : (x, y, z), metres.
    radius : metres.
    importance : factor on the squared error around the vertices; 1 everywhere else.
    lock : True to keep the vertices unchanged.
    """

    center: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        _check_point(self, self.center)
        if not 0 < self.radius < math.inf:
            raise UsageError(
                USAGE_REGION_INVALID, "{self}: the radius must be above 0 and finite.", self=self
            )
        self._check_effect()

    def __str__(self) -> str:
        return f"sphere about {_format_point(self.center)} of radius {self.radius:g} m"

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3), metres, inside the sphere."""
        # By columns: four times faster than by rows of three numbers.
        squared = np.zeros(len(points))
        for column, center in zip(points.T, self.center, strict=True):
            away = column - center
            squared += away * away
        return squared <= self.radius**2


@dataclass(frozen=True)
class Box(_Region):
    """Region of all vertices inside an axis-aligned box.

    Attributes
    ----------
    low, high : (x, y, z), metres, minimum and maximum corner.
    importance : factor on the squared error around the vertices; 1 everywhere else.
    lock : True to keep the vertices unchanged.
    """

    low: tuple[float, float, float]
    high: tuple[float, float, float]

    def __post_init__(self) -> None:
        _check_point(self, self.low)
        _check_point(self, self.high)
        if not all(low <= high for low, high in zip(self.low, self.high, strict=True)):
            raise UsageError(
                USAGE_REGION_INVALID,
                "{self}: the first corner must be the minimum, the second the maximum.",
                self=self,
            )
        self._check_effect()

    def __str__(self) -> str:
        return f"box from {_format_point(self.low)} to {_format_point(self.high)}"

    def contains(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask of the points (n, 3), metres, inside the box."""
        inside = np.ones(len(points), bool)
        for column, low, high in zip(points.T, self.low, self.high, strict=True):
            inside &= (column >= low) & (column <= high)
        return inside


Region = Sphere | Box


def _check_point(region: Region, point: Sequence[float]) -> None:
    if len(point) != 3 or not all(map(math.isfinite, point)):
        raise UsageError(
            USAGE_REGION_INVALID,
            "{region_name} at {point!r}: a position must be three finite numbers, in metres.",
            region_name=type(region).__name__,
            point=point,
        )


def _format_point(point: Sequence[float]) -> str:
    return f"({', '.join(f'{x:g}' for x in point)})"


def parse_region(text: str) -> Region:
    """Parse a region from text.

    Forms are `sphere x y z radius` and `box x y z x y z`, followed by an importance, `lock` or both.

    Raises
    ------
    UsageError
        If the text has another form, or its values are invalid.
    """

    def refuse(why: str) -> NoReturn:
        raise UsageError(
            USAGE_REGION_INVALID,
            "region {text!r}: {why}",
            remedy="write {forms}.",
            text=text,
            why=why,
            forms=_REGION_FORMS,
        )

    shape, *words = text.replace(",", " ").split() or [""]
    sizes = {"sphere": 4, "box": 6}
    if shape not in sizes:
        refuse("it starts with neither sphere nor box")
    lock = words[-1:] == ["lock"]
    try:
        numbers = [float(word) for word in words[: len(words) - lock]]
    except ValueError as error:
        refuse(str(error))
    count = sizes[shape]
    if not count <= len(numbers) <= count + 1:
        refuse(f"a {shape} has {count} numbers and at most one importance, not {len(numbers)} numbers in all")
    effect: dict[str, Any] = {"lock": lock, "importance": numbers[count] if numbers[count:] else None}
    first = (numbers[0], numbers[1], numbers[2])
    if shape == "sphere":
        return Sphere(first, numbers[3], **effect)
    return Box(first, (numbers[3], numbers[4], numbers[5]), **effect)


def resolve_vertex_control(
    mesh: Mesh, lock: ArrayLike | None, importance: ArrayLike | None, regions: Sequence[Region]
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Convert locks, importance and regions to values per vertex.

    Parameters
    ----------
    mesh : the input.
    lock : (n,) bool, or indices of vertices; None for no vertex.
    importance : (n,) numbers above 0; None for 1 everywhere.
    regions : regions that add locks and importance. The maximum of all factors for a vertex applies.

    Returns
    -------
    locked : (n,) bool.
    factors : (n,) float64; (0,) if all are 1.

    Raises
    ------
    UsageError
        For a wrong shape or value, or a region without vertices.
    """
    count = len(mesh.vertices)
    locked = np.zeros(count, bool) if lock is None else _resolve_lock(np.asarray(lock), count)
    own = None if importance is None else _resolve_importance(np.asarray(importance), count)
    largest = np.zeros(count)
    for region in regions:
        inside = region.contains(mesh.vertices)
        if not inside.any():
            raise UsageError(
                USAGE_REGION_INVALID,
                "{region} contains no vertex of the mesh; coordinates are in metres.",
                region=region,
            )
        if region.lock:
            locked |= inside
        if region.importance is not None:
            largest[inside] = np.maximum(largest[inside], region.importance)
    factors = np.where(largest > 0, largest, 1.0) if own is None else np.maximum(own, largest)
    return locked, factors if (factors != 1).any() else np.zeros(0)


def _resolve_lock(lock: NDArray[Any], count: int) -> NDArray[np.bool_]:
    if lock.dtype == bool:
        if lock.shape != (count,):
            raise UsageError(
                USAGE_REGION_INVALID,
                "lock has shape {lock_shape}; one value for each of {count} vertices is expected.",
                lock_shape=lock.shape,
                count=count,
            )
        return np.array(lock, bool)
    locked = np.zeros(count, bool)
    if lock.size == 0:
        return locked
    if lock.ndim != 1 or lock.dtype.kind not in "iu":
        raise UsageError(
            USAGE_REGION_INVALID, "lock must be one bool per vertex, or a list of vertex indices."
        )
    if lock.min() < 0 or lock.max() >= count:
        wrong = next(int(v) for v in lock if not 0 <= v < count)
        raise UsageError(
            USAGE_REGION_INVALID,
            "lock contains vertex index {wrong}, but the mesh has {count} vertices.",
            wrong=wrong,
            count=count,
        )
    locked[lock] = True
    return locked


def _resolve_importance(importance: NDArray[Any], count: int) -> NDArray[np.float64]:
    if importance.shape != (count,) or importance.dtype.kind not in "iuf":
        raise UsageError(
            USAGE_REGION_INVALID,
            (
                "importance has shape {importance_shape} and type {importance_dtype}; one "
                "number for each of {count} vertices is expected."
            ),
            importance_shape=importance.shape,
            importance_dtype=importance.dtype,
            count=count,
        )
    bad = np.flatnonzero(~((importance > 0) & np.isfinite(importance)))
    if len(bad):
        raise UsageError(
            USAGE_REGION_INVALID,
            "importance of vertex {bad} is {importance}; it must be above 0 and finite.",
            bad=bad[0],
            importance=importance[bad[0]],
        )
    return importance.astype(np.float64)
