"""Registry of simplification methods: capabilities, parameters, entry points and result types.

To add a method, create a package next to this file and add a row below. Parameters that only this method has
are a field of SimplifyParams. The help of `method` and the selection by `is_automatic` are derived from the
rows. Type checkers cannot evaluate the table, so `keywords.py` lists the keyword arguments for each method.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, TypeVar

from scanloom.stages.simplification.certified import run as certified
from scanloom.stages.simplification.certified.details import CertifiedDetails
from scanloom.stages.simplification.certified.params import CertifiedParams
from scanloom.stages.simplification.jia01 import run as jia01
from scanloom.stages.simplification.jia01.details import Jia01Details
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.planar import run as planar
from scanloom.stages.simplification.planar.details import PlanarDetails
from scanloom.stages.simplification.planar.params import PlanarParams
from scanloom.stages.simplification.quadric import run as quadric
from scanloom.stages.simplification.quadric.details import QuadricDetails
from scanloom.stages.simplification.result import Details, SimplificationResult
from scanloom.stages.simplification.seams import run as seams
from scanloom.stages.simplification.seams.details import SeamsDetails
from scanloom.stages.simplification.seams.params import SeamsParams
from scanloom.stages.simplification.task import Task

P = TypeVar("P")
D = TypeVar("D", bound=Details)


@dataclass(frozen=True)
class Requirement:
    """Requirement of a method: at least one of some parameters.

    Attributes
    ----------
    description : requirement in words.
    parameters : parameters, any of which meets the requirement.
    advice : remedy for error messages.
    """

    description: str
    parameters: tuple[str, ...]
    advice: str


COUNT_REQUIREMENT = Requirement("a triangle count", ("triangles", "ratio"), "give triangles or ratio")
BOUND_REQUIREMENT = Requirement(
    "an error bound", ("max_shape", "max_color"), "give max_shape, max_color or both"
)


@dataclass(frozen=True, kw_only=True)
class Capabilities:
    """Capabilities of a method, apart from its parameters.

    Attributes
    ----------
    count : can stop at a triangle count.
    texture : preserves texture, materials, parts and corner normals.
    lock, importance : supports locked vertices, and a factor on the error of each vertex.
    record : can record its collapses.
    keep_on_interrupt : returns the mesh simplified so far when interrupted.
    """

    count: bool = True
    texture: bool = False
    lock: bool = True
    importance: bool = True
    record: bool = True
    keep_on_interrupt: bool = True


@dataclass(frozen=True, kw_only=True)
class Method(Generic[P, D]):
    """Row of the method registry.

    Attributes
    ----------
    name, text : name of the method, and its description in the help.
    params : class of the parameters that only this method has, stored in the field of SimplifyParams with the
        method's name; None without any.
    shared : supported parameters that several methods share.
    details : class of the result details.
    run : entry point.
    requirement : requirement, None without any.
    capabilities : capabilities.
    is_automatic : False if `is_automatic` never selects the method.
    proves_bounds : True if the details have `shape_bound` and `color_bound`, proven for every triangle.
    """

    name: str
    text: str
    params: type[P] | None
    details: type[D]
    run: Callable[[Task[P]], SimplificationResult[D]]
    shared: tuple[str, ...] = ()
    requirement: Requirement | None = None
    capabilities: Capabilities = Capabilities()
    is_automatic: bool = True
    proves_bounds: bool = False

    @property
    def result_version(self) -> int:
        """RESULT_VERSION of the module of `run`; increased manually when results change."""
        version: int = sys.modules[self.run.__module__].RESULT_VERSION
        return version

    def supports(self, name: str) -> bool:
        """Return True if the method supports a parameter.

        Nested parameters are written as `planar.crease_angle`.
        """
        return name in self.shared or name.startswith(f"{self.name}.")

    def get_own_params(self, params: Any) -> Any:
        """Return the parameters that only this method has."""
        return None if self.params is None else getattr(params, self.name)


# `is_automatic` tries the methods in this order.
METHODS: tuple[Method[Any, Any], ...] = (
    Method(
        name="quadric",
        text="to a triangle count, with minimum squared error of shape and colour.",
        params=None,
        details=QuadricDetails,
        run=quadric.run,
        shared=("attribute_scale",),
        requirement=COUNT_REQUIREMENT,
    ),
    Method(
        name="certified",
        text="as far as bounds on distance and colour difference are proven for every point, or "
        "to a triangle count within the bounds.",
        params=CertifiedParams,
        details=CertifiedDetails,
        run=certified.run,
        shared=("max_shape", "max_color", "attribute_scale"),
        requirement=BOUND_REQUIREMENT,
        capabilities=Capabilities(texture=True),
        proves_bounds=True,
    ),
    Method(
        name="seams",
        text="to a triangle count, preserving texture coordinates, colours and normals of every "
        "corner, without cracks along texture seams.",
        params=SeamsParams,
        details=SeamsDetails,
        run=seams.run,
        shared=("attribute_scale",),
        requirement=COUNT_REQUIREMENT,
        capabilities=Capabilities(texture=True),
    ),
    Method(
        name="jia01",
        text="within bounds on the accumulated changes of shape and texture.",
        params=Jia01Params,
        details=Jia01Details,
        run=jia01.run,
        shared=("max_shape", "max_color", "attribute_scale"),
        capabilities=Capabilities(importance=False),
    ),
    Method(
        name="planar",
        text="near-planar patches, retriangulated with as few triangles as their borders need, "
        "within bounds; fast, for walls, floors and machined parts.",
        params=PlanarParams,
        details=PlanarDetails,
        run=planar.run,
        shared=("max_shape", "max_color"),
        capabilities=Capabilities(count=False, importance=False, record=False),
        is_automatic=False,
    ),
)
