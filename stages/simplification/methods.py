"""The table of methods: what each needs and takes, its parameters, its call, and what it has to tell.

A new method is a folder next to this file and a row below. If it has parameters that no other method has,
they are a field of SimplifyParams. The help of `method` and the choice of `auto` follow from the rows. Type
checkers read no tables: for them `keywords.py` lists the keywords of `simplify` for each method.
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
from scanloom.stages.simplification.result import Details, Simplified
from scanloom.stages.simplification.seams import run as seams
from scanloom.stages.simplification.seams.details import SeamsDetails
from scanloom.stages.simplification.seams.params import SeamsParams
from scanloom.stages.simplification.task import Task

P = TypeVar("P")
D = TypeVar("D", bound=Details)


@dataclass(frozen=True)
class Need:
    """What a method cannot do without: at least one of these parameters, and how to ask for it."""

    what: str
    names: tuple[str, ...]
    advice: str


COUNT = Need("a number of triangles", ("triangles", "ratio"), "give triangles or ratio")
BOUND = Need("a bound", ("max_shape", "max_color"), "give max_shape, max_color or both")


@dataclass(frozen=True, kw_only=True)
class Takes:
    """What a method can be given besides its parameters.

    Attributes
    ----------
    count : a number of triangles to stop at.
    texture : carries texture, materials, parts and normals of corners, rather than leave them out.
    lock, importance : vertices that stay, and a factor of the error of each.
    record : keeps its collapses.
    partial : gives out what there is when it is interrupted.
    """

    count: bool = True
    texture: bool = False
    lock: bool = True
    importance: bool = True
    record: bool = True
    partial: bool = True


@dataclass(frozen=True, kw_only=True)
class Method(Generic[P, D]):
    """A row of the table.

    Attributes
    ----------
    name, text : what people call it, and what it is for, as the help says it.
    params : the class of the parameters that it alone has; None without any. SimplifyParams has them in the
        field of its name.
    shared : the parameters of several methods that it has, too.
    details : the class of what it alone has to tell.
    run : the call.
    needs : what it cannot do without, if there is such a thing.
    takes : what it can be given besides.
    auto : whether `auto` may take it; otherwise it is there when it is asked for.
    proves : whether its details have `shape_bound` and `color_bound`, proven for every triangle.
    """

    name: str
    text: str
    params: type[P] | None
    details: type[D]
    run: Callable[[Task[P]], Simplified[D]]
    shared: tuple[str, ...] = ()
    needs: Need | None = None
    takes: Takes = Takes()
    auto: bool = True
    proves: bool = False

    @property
    def result_version(self) -> int:
        """The RESULT_VERSION beside its call, which is raised by hand when its results change."""
        version: int = sys.modules[self.run.__module__].RESULT_VERSION
        return version

    def knows(self, name: str) -> bool:
        """Tell if the method has a parameter, such as `max_shape` or `planar.crease_angle`."""
        return name in self.shared or name.startswith(f"{self.name}.")

    def own(self, params: Any) -> Any:
        """Return the parameters that only this method has."""
        return None if self.params is None else getattr(params, self.name)


# In the order in which `auto` asks them.
METHODS: tuple[Method[Any, Any], ...] = (
    Method(
        name="quadric",
        text="to a number of triangles, with the least squared error of shape and colour.",
        params=None,
        details=QuadricDetails,
        run=quadric.run,
        shared=("attribute_scale",),
        needs=COUNT,
    ),
    Method(
        name="certified",
        text="as far as bounds on the distance and on the difference of colour are proven for every point, "
        "or to a number of triangles within them.",
        params=CertifiedParams,
        details=CertifiedDetails,
        run=certified.run,
        shared=("max_shape", "max_color", "attribute_scale"),
        needs=BOUND,
        takes=Takes(texture=True),
        proves=True,
    ),
    Method(
        name="seams",
        text="to a number of triangles, with the texture coordinates, colours and normals of every corner, "
        "and no crack along texture seams.",
        params=SeamsParams,
        details=SeamsDetails,
        run=seams.run,
        shared=("attribute_scale",),
        needs=COUNT,
        takes=Takes(texture=True),
    ),
    Method(
        name="jia01",
        text="within bounds on the summed change of shape and texture.",
        params=Jia01Params,
        details=Jia01Details,
        run=jia01.run,
        shared=("max_shape", "max_color", "attribute_scale"),
        takes=Takes(importance=False),
    ),
    Method(
        name="planar",
        text="near-planar patches with as few triangles as their borders need, within bounds; fast, for "
        "walls, floors and machined parts.",
        params=PlanarParams,
        details=PlanarDetails,
        run=planar.run,
        shared=("max_shape", "max_color"),
        takes=Takes(count=False, importance=False, record=False),
        auto=False,
    ),
)
