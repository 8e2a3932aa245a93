"""Selection of the simplification method from the given parameters."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import find_changed, get_value
from scanloom.stages.simplification.codes import USAGE_METHOD_MISMATCH
from scanloom.stages.simplification.methods import METHODS, Method, Requirement
from scanloom.stages.simplification.params import AUTO, SimplifyParams


def select_method(params: SimplifyParams, *, has_corner_attributes: bool = False) -> Method[Any, Any]:
    """Select the given method, or resolve `auto`.

    `auto` selects the first method of the table that supports all given parameters and has everything it
    requires.

    Parameters
    ----------
    params : parameters of `simplify`.
    has_corner_attributes : True if the mesh has texture, materials, parts or corner normals. Methods that
        preserve these
        are then tried first.

    Raises
    ------
    UsageError
        If the parameters do not fit the given method, or no method supports them.
    """
    given = _list_given(params)
    if params.method != AUTO:
        method = next(method for method in METHODS if method.name == params.method)
        _require_suitable(method, params, given)
        return method
    candidates = [method for method in METHODS if method.is_automatic]
    if has_corner_attributes:
        candidates.sort(key=lambda method: not method.capabilities.texture)
    for method in candidates:
        if not (
            _find_unsupported(method, given)
            or _find_missing_requirement(method, params)
            or _has_no_count(method, params)
        ):
            return method
    # The parameter supported by the fewest methods indicates the intended method best.
    name = min(given, key=lambda name: len(_find_methods_with(name)))
    raise UsageError(
        USAGE_METHOD_MISMATCH,
        "belongs to {why_not}",
        DiagnosticLocation(parameter=name),
        why_not=_explain_rejection(_find_methods_with(name)[0], params, given),
    )


def has_no_goal(params: SimplifyParams) -> bool:
    """Return True if the parameters specify neither a target nor a method.

    `attribute_scale` only weighs colours against shape.
    """
    has_goal = params.triangles is not None or params.ratio is not None
    given = [name for name in _list_given(params) if name != "attribute_scale"]
    return params.method == AUTO and not has_goal and not given


def require_supported(
    method: Method[Any, Any], *, lock: bool, importance: bool, record: bool, keep_on_interrupt: bool
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
        "keep_on_interrupt": keep_on_interrupt,
    }.items():
        if wanted and not getattr(method.capabilities, name):
            others = _join_names(
                [other.name for other in METHODS if getattr(other.capabilities, name)], "and"
            )
            raise UsageError(
                USAGE_METHOD_MISMATCH,
                "{name} is not supported by method {method_name}, only by {others}.",
                name=name,
                method_name=method.name,
                others=others,
            )


def _list_given(params: SimplifyParams) -> list[str]:
    """Return the method-specific parameters that differ from their defaults."""
    return [name for name in find_changed(params) if _find_methods_with(name)]


def _find_methods_with(name: str) -> list[Method[Any, Any]]:
    return [method for method in METHODS if method.supports(name)]


def _require_suitable(method: Method[Any, Any], params: SimplifyParams, given: Collection[str]) -> None:
    foreign, need = _find_unsupported(method, given), _find_missing_requirement(method, params)
    if foreign is not None:
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "is not supported by method {method_name}",
            DiagnosticLocation(parameter=foreign),
            remedy="leave one of them out.",
            method_name=method.name,
        )
    if need is not None:
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "{method_name} needs {what}; {advice}.",
            DiagnosticLocation(parameter="method"),
            method_name=method.name,
            what=need.description,
            advice=need.advice,
        )
    if _has_no_count(method, params):
        raise UsageError(
            USAGE_METHOD_MISMATCH,
            "{method_name} stops only at its bounds",
            DiagnosticLocation(parameter="method"),
            remedy="leave out triangles and ratio.",
            method_name=method.name,
        )


def _explain_rejection(method: Method[Any, Any], params: SimplifyParams, given: Collection[str]) -> str:
    """Explain why the method that a parameter belongs to was not selected."""
    foreign, need = _find_unsupported(method, given), _find_missing_requirement(method, params)
    if not method.is_automatic:
        return f"method {method.name}, which auto never selects; give method {method.name}, too."
    if need is not None:
        return f"method {method.name}, which needs {_join_names(need.parameters, 'or')}."
    if foreign is not None:
        return f"method {method.name}, which does not support {foreign}; leave one of them out."
    return f"method {method.name}, which stops only at its bounds; leave out triangles and ratio."


def _find_unsupported(method: Method[Any, Any], given: Collection[str]) -> str | None:
    """Return the first given parameter that the method does not support."""
    return next((name for name in given if not method.supports(name)), None)


def _find_missing_requirement(method: Method[Any, Any], params: SimplifyParams) -> Requirement | None:
    """Return the requirement of the method that is not met, or None."""
    need = method.requirement
    return (
        None if need is None or any(get_value(params, name) is not None for name in need.parameters) else need
    )


def _has_no_count(method: Method[Any, Any], params: SimplifyParams) -> bool:
    """Return True if the method does not support a given triangle count."""
    return not method.capabilities.count and (params.triangles is not None or params.ratio is not None)


def _join_names(names: Collection[str], conjunction: str) -> str:
    *first, last = names
    return f"{', '.join(first)} {conjunction} {last}" if first else last
