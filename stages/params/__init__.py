"""Declaration of stage parameters.

A stage's frozen parameter class is the single source of its Python signature, command line options, help,
configuration keys and reference page. Each field declares its text, unit and range. Parameters of one of
several methods are a separate class, nested as a field of the stage's class.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass, replace
from functools import cache, reduce
from pathlib import Path
from types import MappingProxyType
from typing import Any, ParamSpec, TypeVar, get_args, get_origin, get_type_hints

from scanloom.stages.diagnostics.codes import CONFIG_PARAMETER_UNKNOWN, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError

P = TypeVar("P")
A = ParamSpec("A")
R = TypeVar("R")


@dataclass(frozen=True)
class ParameterInfo:
    """Metadata of a parameter: help text, unit, range, choices and flags; see `param`."""

    text: str
    unit: str
    low: float | None
    high: float | None
    low_open: bool
    choices: tuple[str, ...]
    invalidates: bool
    group: str
    is_path: bool
    common: bool


def param(
    default: Any,
    text: str,
    *,
    unit: str = "",
    low: float | None = None,
    high: float | None = None,
    low_open: bool = False,
    choices: tuple[str, ...] = (),
    invalidates: bool = True,
    group: str = "",
    is_path: bool = False,
    common: bool = False,
) -> Any:
    """Declare a field of a parameter class.

    Parameters
    ----------
    default : default value. None means that the value is derived from the data; `text` then explains the
        derivation.
    text : help text.
    low, high : allowed range, inclusive. With `low_open`, `low` itself is excluded.
    choices : allowed values.
    invalidates : False if the parameter cannot change the result (threads, previews). The cache then ignores
        it.
    group : heading that groups related parameters in a long help.
    is_path : the value is the name of a file or folder.
    """
    about = ParameterInfo(text, unit, low, high, low_open, choices, invalidates, group, is_path, common)
    return field(default=default, metadata={"param": about})


def describe_own(cls: type) -> dict[str, ParameterInfo]:
    """Return name and metadata of each parameter of a class, in declaration order.

    Nested parameters are not included; see `describe_all`.
    """
    return dict(_describe_own_cached(cls))


@cache
def _describe_own_cached(cls: Any) -> Mapping[str, ParameterInfo]:
    return MappingProxyType({f.name: f.metadata["param"] for f in fields(cls) if "param" in f.metadata})


def find_nested(cls: type) -> dict[str, type]:
    """Return the nested parameter classes by field name."""
    return dict(_find_nested_cached(cls))


@cache
def _find_nested_cached(cls: Any) -> Mapping[str, type]:
    return MappingProxyType(
        {
            f.name: type(f.default)
            for f in fields(cls)
            if is_dataclass(f.default) and describe_own(type(f.default))
        }
    )


def describe_all(cls: type) -> dict[str, ParameterInfo]:
    """Return the metadata of all parameters, nested ones named like `planar.crease_angle`."""
    below = {
        f"{section}.{name}": about
        for section, own in find_nested(cls).items()
        for name, about in describe_all(own).items()
    }
    return {**describe_own(cls), **below}


def get_value(params: Any, name: str) -> Any:
    """Return the value of a parameter by its name, such as `planar.crease_angle`."""
    return reduce(getattr, name.split("."), params)


def find_declaring_class(cls: type, name: str) -> type:
    """Return the class that declares a parameter: `cls` or a nested class."""
    *sections, _ = name.split(".")
    return reduce(lambda owner, section: find_nested(owner)[section], sections, cls)


def get_hint(cls: type, name: str) -> Any:
    """Return the type hint of a parameter by its name, such as `planar.crease_angle`."""
    return resolve_hints(find_declaring_class(cls, name))[name.rpartition(".")[2]]


def get_default(cls: type, name: str) -> Any:
    """Return the declared default of a parameter by its name, such as `planar.crease_angle`."""
    own = name.rpartition(".")[2]
    return next(f.default for f in fields(find_declaring_class(cls, name)) if f.name == own)


def get_group(cls: type, name: str) -> str:
    """Return the heading of a parameter in the help.

    The heading is its group, or else the summary of the nested class that declares it.
    """
    owner = find_declaring_class(cls, name)
    summary = (owner.__doc__ or "").split("\n")[0].replace("`", "").removesuffix(".")
    return describe_all(cls)[name].group or ("" if owner is cls else summary)


def flatten(values: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten nested mappings to names such as `planar.crease_angle`."""
    flat: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            flat.update({f"{name}.{own}": one for own, one in flatten(value).items()})
        else:
            flat[name] = value
    return flat


def find_changed(params: Any) -> list[str]:
    """Return the names of parameters whose values differ from the declared defaults."""
    cls = type(params)
    return [name for name in describe_all(cls) if get_value(params, name) != get_default(cls, name)]


def resolve_hints(cls: Any) -> Mapping[str, Any]:
    """Return the type hints of a class, cached because resolving takes about 1 ms."""
    return _resolve_hints_cached(cls)


# Annotated as Any: mypy does not accept `type[Any]` as hashable.
@cache
def _resolve_hints_cached(cls: Any) -> Mapping[str, Any]:
    return MappingProxyType(get_type_hints(cls))


def get_allowed_types(hint: Any) -> tuple[Any, ...]:
    """Return the types that a type hint allows, without None.

    A tuple of numbers counts as one type.
    """
    if get_origin(hint) is tuple:
        return (hint,)
    return tuple(kind for kind in (get_args(hint) or (hint,)) if kind is not type(None))


def get_row_length(hint: Any) -> int:
    """Return the length of a tuple-valued parameter (`tuple[float, ...]`); 0 for others."""
    rows = [kind for kind in get_allowed_types(hint) if get_origin(kind) is tuple]
    return len(get_args(rows[0])) if rows else 0


def describe_kinds(kinds: Iterable[Any]) -> str:
    """Return the types of a parameter in words: "a number", "3 numbers", "a file or text"."""
    return " or ".join(
        f"{len(get_args(kind))} numbers"
        if get_origin(kind) is tuple
        else _KIND_NAMES.get(kind, f"of type {kind.__name__}")
        for kind in kinds
    )


_KIND_NAMES: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a file",
}


def check_parameters(params: Any) -> None:
    """Check the type and range of every parameter; called by `__post_init__`.

    A tuple of numbers may be given as any sequence and is stored as a tuple.

    Raises
    ------
    UsageError
        For the first invalid value.
    """
    cls: Any = type(params)
    for name, about, kinds, length, may_be_none in _collect_checks(cls):
        value = getattr(params, name)
        if value is None and may_be_none:
            continue
        if length:
            object.__setattr__(params, name, _convert_row(name, value, length))
            continue
        _check_type(name, value, kinds)
        if about.choices and value not in about.choices:
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {value!r}; it must be one of {choices}.",
                DiagnosticLocation(parameter=name),
                name=name,
                value=value,
                choices=", ".join(about.choices),
            )
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            _check_range(name, value, about)
    for name, own in find_nested(cls).items():
        _check_type(name, getattr(params, name), (own,))


@cache
def _collect_checks(cls: Any) -> tuple[tuple[str, ParameterInfo, tuple[Any, ...], int, bool], ...]:
    """Collect the facts that `check_parameters` needs of each parameter, cached per class.

    Returns name, metadata, allowed types, tuple length (0 for scalars), and True if None is allowed.
    """
    hints = resolve_hints(cls)
    return tuple(
        (
            name,
            about,
            get_allowed_types(hints[name]),
            get_row_length(hints[name]),
            type(None) in getattr(hints[name], "__args__", ()),
        )
        for name, about in describe_own(cls).items()
    )


def _convert_row(name: str, value: Any, count: int) -> tuple[float, ...]:
    numbers = () if isinstance(value, str) or not hasattr(value, "__len__") else tuple(value)
    try:
        row = tuple(float(number) for number in numbers if not isinstance(number, (str, bool)))
    except (TypeError, ValueError):
        row = ()
    if not len(row) == len(numbers) == count or not all(map(math.isfinite, row)):
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {value!r}; it must be {count} finite numbers.",
            DiagnosticLocation(parameter=name),
            value=value,
            count=count,
        )
    return row


def _check_type(name: str, value: Any, types: tuple[Any, ...]) -> None:
    accepted = (*types, int) if float in types else types
    if not isinstance(value, accepted) or (isinstance(value, bool) and bool not in types):
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {value!r}; it must be {names}.",
            DiagnosticLocation(parameter=name),
            value=value,
            names=describe_kinds(types),
        )
    if isinstance(value, (str, Path)) and "\0" in str(value):
        raise UsageError(
            USAGE_VALUE_INVALID, "contains a null character.", DiagnosticLocation(parameter=name)
        )
    # Larger integers cannot be compared with numbers, and the largest cannot even be printed.
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        raise UsageError(
            USAGE_VALUE_INVALID, "is an integer of more than 64 bits.", DiagnosticLocation(parameter=name)
        )


def _check_range(name: str, value: float, info: ParameterInfo) -> None:
    unit = f" {info.unit}" if info.unit else ""
    if math.isnan(value):
        raise UsageError(USAGE_VALUE_INVALID, "is not a number.", DiagnosticLocation(parameter=name))
    if info.low is not None and (value < info.low or (info.low_open and value == info.low)):
        bound = "more than" if info.low_open else "at least"
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {value:g}{unit}; it must be {bound} {low:g}{unit}.",
            DiagnosticLocation(parameter=name),
            value=value,
            unit=unit,
            bound=bound,
            low=info.low,
        )
    if info.high is not None and value > info.high:
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {value:g}{unit}; it must be at most {high:g}{unit}.",
            DiagnosticLocation(parameter=name),
            value=value,
            unit=unit,
            high=info.high,
        )


def resolve(cls: type[P], params: P | None, changes: Mapping[str, object], *, section: str = "") -> P:
    """Return the parameters of a call: `params` or the defaults, with changes applied.

    A nested parameter class can be changed by a mapping of the values to replace.

    Parameters
    ----------
    section : prefix of names in messages, such as `planar.`.

    Raises
    ------
    UsageError
        If a changed parameter does not exist, or its value is invalid.
    """
    unknown = sorted(set(changes) - set(describe_own(cls)) - set(find_nested(cls)))
    if unknown:
        raise UsageError(
            CONFIG_PARAMETER_UNKNOWN,
            "unknown parameter {unknown!r}; {advice}",
            unknown=f"{section}{unknown[0]}",
            advice=suggest_parameter(unknown[0], cls),
        )
    base = cls() if params is None else params
    return apply_changes(base, changes) if changes else base


def apply_changes(params: P, changes: Mapping[str, object]) -> P:
    """Replace some parameters; a mapping replaces values of a nested class."""
    values = dict(changes)
    for name, own in find_nested(type(params)).items():
        given = values.get(name)
        if isinstance(given, Mapping):
            try:
                values[name] = resolve(own, getattr(params, name), given, section=f"{name}.")
            except UsageError as error:
                where = error.diagnostic.where
                if where is None or where.parameter is None:
                    raise
                nested_name = f"{name}.{where.parameter}"
                raise UsageError.from_diagnostic(
                    error.diagnostic.replace_location_fields(parameter=nested_name)
                ) from error
    return replace(params, **values)  # type: ignore[type-var]


def suggest_parameter(word: str, cls: type) -> str:
    """Suggest an existing parameter for an unknown name, as part of a sentence."""
    names = [*describe_own(cls), *find_nested(cls)]
    below = [name for name in describe_all(cls) if name.endswith(f".{word}")]
    near = below or difflib.get_close_matches(word, [*names, *describe_all(cls)], n=1)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(names)}."
