"""Mesh kernels in Rust. Private: `stages.simplify` is the way in."""

from collections.abc import Callable
from typing import TypeAlias, final

import numpy as np
from numpy.typing import NDArray

__all__ = ["Certified", "InvalidMeshError", "LimitError", "Simplified", "certify", "simplify"]

class InvalidMeshError(ValueError):
    """The mesh breaks a rule the kernels need; the message names the elements."""

class LimitError(OverflowError):
    """The result would be larger than the stated limit."""

@final
class Simplified:
    """A simplified mesh and how it came about. `standing_*` count the edges each rule holds at the end."""

    @property
    def vertices(self) -> NDArray[np.float64]: ...
    @property
    def attributes(self) -> NDArray[np.float64]: ...
    @property
    def triangles(self) -> NDArray[np.int32]: ...
    @property
    def vertex_source(self) -> NDArray[np.int32]: ...
    @property
    def triangle_source(self) -> NDArray[np.int32]: ...
    @property
    def stopped_by(self) -> str: ...
    @property
    def standing_length(self) -> int: ...
    @property
    def standing_shape(self) -> int: ...
    @property
    def standing_texture(self) -> int: ...
    @property
    def standing_topology(self) -> int: ...
    @property
    def standing_bridge(self) -> int: ...
    @property
    def standing_fold(self) -> int: ...
    @property
    def splits(self) -> int: ...
    @property
    def split_triangles(self) -> int: ...
    @property
    def collapses(self) -> int: ...
    @property
    def attempts(self) -> int: ...
    @property
    def largest_shape_change(self) -> float: ...
    @property
    def largest_texture_change(self) -> float: ...

def simplify(
    vertices: NDArray[np.float64],
    attributes: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    bounds: tuple[float, float, float],
    scales: tuple[float, float, float],
    attribute_scale: float,
    paper_rule: bool,
    target_triangles: int,
    triangle_limit: int,
    progress: Callable[[int, int], object],
) -> Simplified:
    """Simplify with JIA01; `bounds` and `scales` are (length, shape, texture), infinite for no bound.

    Raises InvalidMeshError for a mesh it cannot work on, LimitError when splitting would pass
    `triangle_limit`.
    """

_Soup: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int32]]

@final
class Certified:
    """Upper bounds by triangle; pairs are (shape in metres, colour in levels)."""

    @property
    def shape_bound(self) -> NDArray[np.float64]: ...
    @property
    def color_bound(self) -> NDArray[np.float64]: ...
    @property
    def original_shape_bound(self) -> NDArray[np.float64]: ...
    @property
    def original_color_bound(self) -> NDArray[np.float64]: ...
    @property
    def bound(self) -> tuple[float, float]: ...
    @property
    def attained(self) -> tuple[float, float]: ...
    @property
    def slack(self) -> float: ...
    @property
    def color_slack(self) -> float: ...
    @property
    def pieces(self) -> int: ...

def certify(
    result: _Soup,
    original: _Soup,
    *,
    tolerance: tuple[float, float],
    absolute_tolerance: tuple[float, float],
    limit: tuple[float, float] | None,
    effort: float,
    slack: float | None,
    threads: int,
    progress: Callable[[int, int], object],
) -> Certified:
    """Bound how far two triangle soups (vertices, attributes, triangles) are apart.

    Raises InvalidMeshError for an index out of range or a value that is not finite.
    """
