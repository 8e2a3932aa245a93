"""Result of `simplify`, with details of the method."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.simplification.small_feature_removal import RemovalCounts
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.bake import BakeResult


@dataclass(frozen=True)
class KeptImages:
    """Colour errors that led to keeping the model's own images.

    Attributes
    ----------
    rmse_levels : with its own images (8-bit levels).
    baked_rmse_levels : with baked images.
    """

    rmse_levels: float
    baked_rmse_levels: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Details:
    """Base class for the result details of a method.

    Attributes
    ----------
    headline : format string over the statistics, for the summary line of a run.
    arrays : names of array fields, which statistics omit.
    """

    headline: ClassVar[str] = "{triangles:,} triangles, stopped by {stopped_by}"
    arrays: ClassVar[tuple[str, ...]] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return all fields except arrays, ready for JSON."""
        names = (field.name for field in fields(self) if field.name not in self.arrays)
        return {name: _to_json_value(getattr(self, name)) for name in names}

    def report(self, result: SimplificationResult[Any]) -> None:
        """Emit warnings about the result; none by default."""

    def describe(self) -> str:
        """Return additional explanations for the user; empty by default."""
        return ""


D_co = TypeVar("D_co", bound=Details, covariant=True)


@dataclass(frozen=True, eq=False)
class SimplificationResult(Generic[D_co]):
    """Simplified mesh, its relation to the input, and the reasons for stopping.

    Attributes
    ----------
    mesh : Mesh
    vertex_source : (p,) int32, an input vertex merged into each vertex.
    triangle_source : (q,) int32, input triangle that each triangle derives from.
    method : name of the method.
    stopped_by : "bounds" if no edge may collapse any more; "triangles" if the triangle count was reached;
        "request" if the caller stopped early; "unproven" if the bounds cannot be proven. Such bounds may not
        even hold between the input and itself, for example where sheets of different colours touch.
    refused : edges of the result, by the rule that last refused their collapse. The rules "length", "shape",
        "texture" and "color" are bounds. "topology" stands for a change of topology, "bridge" for an edge
        across the interior between two border vertices, "fold" for a flipped or degenerate triangle. "needle"
        stands for a triangle too thin for a proof, "seam" for cutting or joining texture seams. "chart"
        stands for a triangle that would flip in the image or leave its chart, "drift" for the bound
        `max_seam_drift`, "locked" for an edge between locked vertices. Edges that were not tried are not
        counted. Methods without edge collapses have other rules.
    collapses, attempts : collapsed edges; tried edges, some of them repeatedly.
    triangles_before : triangle count of the input.
    details : result details of the method.
    record : all collapses, if requested; else None.
    dropped : small components and holes removed before simplification, with `drop_below`; else None.
    kept_images : colour errors, if the model's own images were preferred to baked ones; else None.
    baked : images baked for the mesh, with their colour error; else None.
    default_max_shape : metres, bound derived from the model because no target was given; else None.
    diagnostics : warnings about changed or lost data, and unmet requirements.
    """

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    mesh: Mesh
    vertex_source: NDArray[np.int32]
    triangle_source: NDArray[np.int32]
    method: str
    stopped_by: str
    refused: dict[str, int]
    collapses: int
    attempts: int
    triangles_before: int
    details: D_co
    record: CollapseRecord | None = None
    dropped: RemovalCounts | None = None
    kept_images: KeptImages | None = None
    baked: BakeResult | None = None
    default_max_shape: float | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    def map_vertex_values(self, values: NDArray[Any]) -> NDArray[Any]:
        """Map vertex values (n, …) of the input to the result (p, …)."""
        return values[self.vertex_source]

    def to_dict(self) -> dict[str, Any]:
        """Return statistics ready for JSON; the method's own statistics are under "details"."""
        triangles = len(self.mesh.triangles)
        of_baking = {} if self.baked is None else {"baked": self.baked.to_dict()}
        derived = {} if self.default_max_shape is None else {"default_max_shape_m": self.default_max_shape}
        return {
            "method": self.method,
            "triangles_before": self.triangles_before,
            "triangles": triangles,
            "vertices": len(self.mesh.vertices),
            "reduction": 1 - triangles / self.triangles_before if self.triangles_before else 0.0,
            "stopped_by": self.stopped_by,
            "refused_edges": dict(self.refused),
            "collapses": self.collapses,
            "attempts": self.attempts,
            **({} if self.dropped is None else {"dropped": self.dropped.to_dict()}),
            **({} if self.kept_images is None else {"kept_images": asdict(self.kept_images)}),
            "details": self.details.to_dict(),
            **derived,
            **of_baking,
        }


def _to_json_value(value: Any) -> Any:
    if isinstance(value, dict):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value
