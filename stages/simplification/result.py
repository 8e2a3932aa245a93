"""What `simplify` returns: what every method has to tell, and details of the method's own type."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields
from typing import Any, ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.printing import by_figures, table
from scanloom.stages.simplification.dropping import Dropped
from scanloom.stages.simplification.records.record import CollapseRecord
from scanloom.stages.surface.mesh import Mesh
from scanloom.stages.texturing.bake import Baked


@dataclass(frozen=True)
class KeptImages:
    """Colour errors that led to a model's own images being kept.

    Attributes
    ----------
    rmse_levels : with its own images (8-bit levels).
    baked_rmse_levels : with baked images.
    """

    rmse_levels: float
    baked_rmse_levels: float


@dataclass(frozen=True, eq=False, kw_only=True)
class Details:
    """What a method alone has to tell of its result; each method derives a class from this one.

    Attributes
    ----------
    headline : the line that a run prints of it: a format string over the figures.
    arrays : the fields that are no figures.
    """

    headline: ClassVar[str] = "{triangles:,} triangles, stopped by {stopped_by}"
    arrays: ClassVar[tuple[str, ...]] = ()

    def figures(self) -> dict[str, Any]:
        """Return everything but the arrays, ready for JSON."""
        names = (field.name for field in fields(self) if field.name not in self.arrays)
        return {name: _plain(getattr(self, name)) for name in names}

    def report(self, result: Simplified[Any]) -> None:
        """Emit warnings about the result; none by default."""

    def text(self) -> str:
        """Return what else to say to a person who has seen the figures; nothing if there is nothing."""
        return ""


D_co = TypeVar("D_co", bound=Details, covariant=True)


@dataclass(frozen=True, eq=False)
class Simplified(Generic[D_co]):
    """A simplified mesh, where its parts came from, and what limited it.

    Attributes
    ----------
    mesh : Mesh
    vertex_source : (p,) int32, for each vertex an input vertex that became part of it.
    triangle_source : (q,) int32, for each triangle the input triangle it is what is left of.
    method : the name of the method.
    stopped_by : "bounds" when no edge may collapse any more, "triangles" when the wanted number was reached,
        "request" when the caller was content with less, "unproven" when the bounds cannot be proven: they do
        not even hold between the input and itself, as where sheets of different colours touch.
    refused : edges of the result by the rule that refused them last: "length", "shape", "texture" and "color"
        are bounds; "topology" stands for a changed topology, "bridge" for an edge across the interior
        between two boundary vertices, "fold" for a flipped or degenerate triangle, "needle" for one too thin
        for a proof, "seam" for an edge that would cut or join texture seams, "chart" for one that would turn
        a triangle over in the image or take a texture coordinate out of its chart, "drift" for the bound
        max_seam_drift, "locked" for an edge between two vertices that must stay. Edges whose turn had not
        come are not counted. A method that collapses no edges has rules of its own.
    collapses, attempts : edges that collapsed; edges whose turn came, some repeatedly.
    triangles_before : triangles of the input.
    details : what only this method has to tell.
    record : all collapses, if that was asked for.
    dropped : small components and holes removed before simplification, with `drop_below`; else None.
    kept_images : colour errors, where the model's own images were chosen over baked ones; else None.
    baked : Baked, where images were baked for the mesh, with their colour error; None where none were.
    default_max_shape : metres, the bound that was derived from the model as nothing was asked; else None.
    diagnostics : what was left out or changed, and requirements that are not reached.
    """

    __repr__ = by_figures
    _repr_html_ = table

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
    dropped: Dropped | None = None
    kept_images: KeptImages | None = None
    baked: Baked | None = None
    default_max_shape: float | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    def follow(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return an array (n, …) over the input's vertices for the result's: (p, …)."""
        return values[self.vertex_source]

    def figures(self) -> dict[str, Any]:
        """Everything but the arrays, ready for JSON; what the method alone has to tell is under "details"."""
        triangles = len(self.mesh.triangles)
        of_baking = {} if self.baked is None else {"baked": self.baked.figures()}
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
            **({} if self.dropped is None else {"dropped": self.dropped.figures()}),
            **({} if self.kept_images is None else {"kept_images": asdict(self.kept_images)}),
            "details": self.details.figures(),
            **derived,
            **of_baking,
        }


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return dict(value)
    return list(value) if isinstance(value, tuple) else value
