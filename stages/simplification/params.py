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
from scanloom.stages.simplification.shared_params import METHOD_GROUP, SharedParams

AUTO = "auto"


def _build_method_help(methods: Sequence[Method[Any, Any]]) -> str:
    """Build the help text of the parameter `method`."""
    automatic_names = ", ".join(method.name for method in methods if method.is_automatic)
    texture_names = " or ".join(
        method.name for method in methods if method.is_automatic and method.capabilities.texture
    )
    texts = " ".join(f"{method.name}: {method.text}" for method in methods)
    return (
        f"{texts} {AUTO}: the first of {automatic_names} that supports all given parameters and has "
        "everything it "
        f"requires; {texture_names} is preferred if the mesh has materials, parts or corner normals, or if "
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
        _build_method_help(METHODS),
        group=METHOD_GROUP,
        choices=(AUTO, *(method.name for method in METHODS)),
        common=True,
    )
    certified: CertifiedParams = field(default=CertifiedParams())
    seams: SeamsParams = field(default=SeamsParams())
    jia01: Jia01Params = field(default=Jia01Params())
    planar: PlanarParams = field(default=PlanarParams())
