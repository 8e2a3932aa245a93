"""Selection of the simplification method from the given parameters."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import find_changed, get_value
from scanloom.stages.simplification.codes import USAGE_METHOD_MISMATCH
from scanloom.stages.simplification.methods import METHODS, Method, Need
from scanloom.stages.simplification.params import AUTO, SimplifyParams


def chosen(params: SimplifyParams, *, in_pieces: bool = False) -> Method[Any, Any]:
    """Select the given method, or resolve `auto`.

    `auto` selects the first method of the table that supports all given parameters and has everything it
    requires.

    Parameters
    ----------
    params : parameters of `simplify`.
    in_pieces : True if the mesh has texture, materials, parts or corner normals. Methods that preserve these
        are then tried first.

    Raises
    ------
    UsageError
        If the parameters do not fit the given method, or no method supports them.
    """
    given = _given(params)
    if params.method != AUTO:
        method = next(method for method in METHODS if method.name == params.method)
        _require_suited(method, params, given)
        return method
    candidates = [method for method in METHODS if method.auto]
    if in_pieces:
        candidates.sort(key=lambda method: not method.takes.texture)
    for method in candidates:
        if not (_foreign(method, given) or _lacking(method, params) or _has_no_count(method, params)):
            return method
    # The parameter supported by the fewest methods indicates the intended method best.
    name = min(given, key=lambda name: len(_knowing(name)))
    raise UsageError(
        USAGE_METHOD_MISMATCH,
        "belongs to {why_not}",
        Where(parameter=name),
        why_not=_why_not(_knowing(name)[0], params, given),
    )


def has_no_goal(params: SimplifyParams) -> bool:
    """Return True if the parameters specify neither a target nor a method."""
    has_goal = params.triangles is not None or params.ratio is not None
    return params.method == AUTO and not has_goal and not _given(params)


def require_taken(
    method: Method[Any, Any], *, lock: bool, importance: bool, record: bool, partial: bool
) -> None:
    """Reject the first requested feature that the method does not support.

    Raises
    ------
    UsageError
        Naming the feature and the methods that support it.
    """
    for name, wanted in {
        "lock": lock,
        "importance": importance,
        "record": record,
        "partial": partial,
    }.items():
        if wanted and not getattr(method.takes, name):
            others = _listed([other.name for other in METHODS if getattr(other.takes, name)], "and")
            raise UsageError(
                USAGE_METHOD_MISMATCH,
                "{name} is not supported by method {method_name}, only by {others}.",
                name=name,
                method_name=method.name,
                others=others,
            )


def _given(params: SimplifyParams) -> list[str]:
    """Return the method-specific parameters that differ from their defaults."""
    return [name for name in find_changed(params) if _knowing(name)]


def _knowing(name: str) -> list[Method[Any, Any]]:
    return [method for method in METHODS if method.knows(name)]


def _require_suited(method: Method[Any, Any], params: SimplifyParams, given: Collection[str]) -> None:
    foreign, need = _foreign(method, given), _lacking(method, params)
    if foreign is not None:
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "is not supported by method {method_name}",
            Where(parameter=foreign),
            remedy="leave one of them out.",
            method_name=method.name,
        )
    if need is not None:
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "{method_name} needs {what}; {advice}.",
            Where(parameter="method"),
            method_name=method.name,
            what=need.what,
            advice=need.advice,
        )
    if _has_no_count(method, params):
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "{method_name} stops only at its bounds",
            Where(parameter="method"),
            remedy="leave out triangles and ratio.",
            method_name=method.name,
        )


def _why_not(method: Method[Any, Any], params: SimplifyParams, given: Collection[str]) -> str:
    """Explain why the method that a parameter belongs to was not selected."""
    foreign, need = _foreign(method, given), _lacking(method, params)
    if not method.auto:
        return f"method {method.name}, which auto never selects; give method {method.name}, too."
    if need is not None:
        return f"method {method.name}, which needs {_listed(need.names, 'or')}."
    if foreign is not None:
        return f"method {method.name}, which does not support {foreign}; leave one of them out."
    return f"method {method.name}, which stops only at its bounds; leave out triangles and ratio."


def _foreign(method: Method[Any, Any], given: Collection[str]) -> str | None:
    """Return the first given parameter that the method does not support."""
    return next((name for name in given if not method.knows(name)), None)


def _lacking(method: Method[Any, Any], params: SimplifyParams) -> Need | None:
    """Return the requirement of the method that is not met, or None."""
    need = method.needs
    return None if need is None or any(get_value(params, name) is not None for name in need.names) else need


def _has_no_count(method: Method[Any, Any], params: SimplifyParams) -> bool:
    """Return True if the method does not support a given triangle count."""
    return not method.takes.count and (params.triangles is not None or params.ratio is not None)


def _listed(names: Collection[str], word: str) -> str:
    *first, last = names
    return f"{', '.join(first)} {word} {last}" if first else last
