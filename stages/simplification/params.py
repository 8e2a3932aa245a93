"""Parameters of `simplify`: shared ones, and one nested class for each method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from scanloom.stages.params import param
from scanloom.stages.simplification.certified.params import CertifiedParams
from scanloom.stages.simplification.jia01.params import Jia01Params
from scanloom.stages.simplification.methods import METHODS, Method
from scanloom.stages.simplification.planar.params import PlanarParams
from scanloom.stages.simplification.seams.params import SeamsParams
from scanloom.stages.simplification.shared_params import HOW, SharedParams

AUTO = "auto"


def _method_text(methods: Sequence[Method[Any, Any]]) -> str:
    """Build the help text of the parameter `method`."""
    asked = ", ".join(method.name for method in methods if method.auto)
    carrying = " or ".join(method.name for method in methods if method.auto and method.takes.texture)
    texts = " ".join(f"{method.name}: {method.text}" for method in methods)
    return (
        f"{texts} {AUTO}: the first of {asked} that supports all given parameters and has everything it "
        f"requires; {carrying} is preferred if the mesh has materials, parts or corner normals, or if "
        "keep_uv is given. A textured model without a target is simplified within 1/1000 of its size."
    )


@dataclass(frozen=True, kw_only=True)
class SimplifyParams(SharedParams):
    """Parameters of `simplify`.

    All given bounds apply, also together with `triangles` or `ratio`: whichever is reached first stops the
    simplification. The nested field of a method has the parameters that only this method has. Changing one of
    them makes `auto` select this method.
    """

    method: str = param(
        AUTO,
        _method_text(METHODS),
        group=HOW,
        choices=(AUTO, *(method.name for method in METHODS)),
        common=True,
    )
    certified: CertifiedParams = field(default=CertifiedParams())
    seams: SeamsParams = field(default=SeamsParams())
    jia01: Jia01Params = field(default=Jia01Params())
    planar: PlanarParams = field(default=PlanarParams())
