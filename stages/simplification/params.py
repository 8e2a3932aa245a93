"""How, and how far, `simplify` goes: the parameters of all methods in one flat class, made from the table."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import MISSING, dataclass, fields, make_dataclass
from typing import TYPE_CHECKING, Any, get_args

from stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from stages.diagnostics.diagnostic import Where
from stages.diagnostics.errors import UsageError
from stages.params import check, described, hints_of, param
from stages.simplification.methods import METHODS, Method
from stages.simplification.shared_params import HOW_FAR

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from stages.simplification.keywords import SimplifyKeywords

AUTO = "auto"

_HOW = "How"
# What may differ between methods that have the same parameter: what it means, and where the help shows it.
_COMMON_TRAITS = ("unit", "low", "high", "low_open", "choices", "invalidates")


def _method_text(methods: Sequence[Method[Any, Any]]) -> str:
    """Say what each method is for, and which one `auto` takes."""
    asked = ", ".join(method.name for method in methods if method.auto)
    carrying = " or ".join(method.name for method in methods if method.auto and method.takes.texture)
    texts = " ".join(f"{method.name}: {method.text}" for method in methods)
    return (
        f"{texts} {AUTO}: the first of {asked} that has all parameters that are given, and is given what it "
        f"needs; {carrying} comes first if the mesh has materials, parts or normals of corners, or keep_uv "
        "is given. A textured model without a goal is simplified within 1/1000 of its size."
    )


@dataclass(frozen=True, kw_only=True)
class _Goal:
    """What every method is told."""

    triangles: int | None = param(
        None, "Stop when at most this many triangles are left.", group=HOW_FAR, low=1
    )
    ratio: float | None = param(
        None,
        "Stop when at most this share of the input's triangles is left.",
        group=HOW_FAR,
        low=0,
        high=1,
        low_open=True,
    )
    drop_below: float | None = param(
        None,
        "Before simplification, remove connected components and fill holes whose bounding box has a shorter "
        "diagonal than this. The result reports their number and area; no bound covers them.",
        unit="m",
        group=HOW_FAR,
        low=0,
        low_open=True,
    )
    method: str = param(
        AUTO, _method_text(METHODS), group=_HOW, choices=(AUTO, *(method.name for method in METHODS))
    )
    keep_uv: bool = param(
        False,
        "Keep the model's own texture coordinates and images, rather than bake new ones: seams then hold the "
        "shape in place.",
        group=_HOW,
    )
    bake: bool | None = param(
        None,
        "Bake new images for the simplified mesh, in the format and no more texels than those of the input; "
        "vertex colours go into an image too. Off: textures are lost. Default: where the input has images, "
        "unless keep_uv or a method that carries them is given.",
        group=_HOW,
    )
    threads: int | None = param(
        None,
        "Parts of the mesh worked on at the same time, with the same result; one a core if not given.",
        group=_HOW,
        low=1,
        high=256,
        invalidates=False,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.keep_uv and self.bake:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "and bake are both given",
                Where(parameter="keep_uv"),
                remedy="give one of them.",
            )
        if self.triangles is not None and self.ratio is not None:
            raise UsageError(
                USAGE_OPTIONS_CONFLICT,
                "and ratio are both given",
                Where(parameter="triangles"),
                remedy="give one of them.",
            )
        # What a method's own class refuses is refused now, before any work.
        for method in METHODS:
            method.own(self)

    def target(self, triangles: int) -> int | None:
        """Return how many of so many triangles are wanted; None if there is no such wish."""
        return math.floor(self.ratio * triangles) if self.ratio is not None else self.triangles


def _of_methods() -> list[tuple[str, Any, Any]]:
    """Return name, type and field of each parameter that only some methods have; all default to None."""
    names = dict.fromkeys(name for method in METHODS for name in described(method.params))
    return [_flat_field(name, [method for method in METHODS if method.knows(name)]) for name in names]


def _flat_field(name: str, methods: Sequence[Method[Any, Any]]) -> tuple[str, Any, Any]:
    about = [described(method.params)[name] for method in methods]
    kinds = [hints_of(method.params)[name] for method in methods]
    traits = [{trait: getattr(one, trait) for trait in _COMMON_TRAITS} for one in about]
    if any(_with_none(kind) != _with_none(kinds[0]) for kind in kinds) or traits[1:] != traits[:-1]:
        raise TypeError(f"{name} differs between {', '.join(method.name for method in methods)}")
    # Methods that say the same of it share a sentence.
    saying: dict[str, list[str]] = {}
    for method in methods:
        saying.setdefault(_text(method, name), []).append(method.name)
    text = " ".join(f"{', '.join(names)}: {words}" for words, names in saying.items())
    group = about[0].group or (f"For method {methods[0].name}" if len(methods) == 1 else _HOW)
    return name, kinds[0] | None, param(None, text, group=group, **traits[0])


def _with_none(kind: Any) -> frozenset[Any]:
    return frozenset(get_args(kind) or (kind,)) | {type(None)}


def _text(method: Method[Any, Any], name: str) -> str:
    """Return what a method says of a parameter, with its default, to follow the method's name."""
    text = described(method.params)[name].text.rstrip()
    default = next(f.default for f in fields(method.params) if f.name == name)
    if default is not None and default is not MISSING:
        shown = ("on" if default else "off") if isinstance(default, bool) else f"{default:g}"
        text = f"{text} Default: {shown}."
    return text[0].lower() + text[1:]


if TYPE_CHECKING:

    class SimplifyParams(_Goal):
        """How, and how far, `simplify` goes."""

        def __init__(self, **given: Unpack[SimplifyKeywords]) -> None: ...
        def __getattr__(self, name: str) -> Any: ...

else:
    SimplifyParams = make_dataclass(
        "SimplifyParams",
        _of_methods(),
        bases=(_Goal,),
        namespace={
            "__module__": __name__,
            "__doc__": "How, and how far, `simplify` goes.\n\n"
            "Any bound that is given is kept, also with `triangles` or `ratio`: whichever comes first "
            "ends the work. A parameter that is None has the default of the method that is taken.",
        },
        frozen=True,
        kw_only=True,
    )
