"""Configuration in sections, one frozen parameter object each: read from TOML or words, written as TOML.

Names, types, units, ranges and texts are declared in the parameter classes of the stages.
"""

from __future__ import annotations

import dataclasses
import difflib
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, TypeVar, get_args

from scanloom.stages.diagnostics.codes import CONFIG_PARAMETER_UNKNOWN, CONFIG_UNREADABLE, USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.files.documents import parse_toml
from scanloom.stages.files.input_files import read_input_text
from scanloom.stages.params import (
    ParameterInfo,
    apply_changes,
    describe_all,
    describe_kinds,
    describe_own,
    find_nested,
    get_allowed_types,
    get_default,
    get_row_length,
    resolve_hints,
)
from scanloom.stages.params.lengths import parse_length

_MAX_BYTES = 1 << 22
S = TypeVar("S", bound="Sections")
P = TypeVar("P")

_WORDS = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}


class Sections:
    """Base of frozen configuration dataclasses; each field is a section with a parameter object."""

    # Presets by name: parameter values that replace defaults, by section.
    QUALITIES: ClassVar[Mapping[str, Mapping[str, Mapping[str, Any]]]] = {}

    @classmethod
    def from_quality(cls: type[S], quality: str) -> S:
        """Create the configuration of a quality preset.

        Raises
        ------
        UsageError
            If `QUALITIES` has no such preset.
        """
        if quality not in [*cls.QUALITIES]:  # the value from a file may be unhashable
            raise UsageError(
                USAGE_VALUE_INVALID,
                "is {quality!r}; it must be one of {qualities}.",
                DiagnosticLocation(parameter="quality"),
                quality=quality,
                qualities=", ".join(cls.QUALITIES),
            )
        config = cls()
        for section, values in cls.QUALITIES[quality].items():
            config = config._apply_values(section, values, f"quality {quality}")
        return config

    @classmethod
    def get_types(cls) -> dict[str, type]:
        """Return the parameter class of each section, in order."""
        hints = resolve_hints(cls)
        return {f.name: hints[f.name] for f in dataclasses.fields(cls)}  # type: ignore[arg-type]

    @classmethod
    def load(cls: type[S], path: Path, quality: str | None = None) -> S:
        """Read a TOML file.

        Parameters that the file does not set keep the default or preset value.

        Parameters
        ----------
        quality : preset that overrides the preset named in the file.

        Raises
        ------
        UsageError
            If the file cannot be read, is not TOML, or has an unknown section, parameter or value.
        """
        try:
            if path.stat().st_size > _MAX_BYTES:
                raise UsageError(CONFIG_UNREADABLE, "the file is too large for a configuration.", where=path)
            text = read_input_text(path, "utf-8")
        except OSError as error:
            raise UsageError(
                CONFIG_UNREADABLE,
                "the config file cannot be read ({strerror}).",
                where=path,
                strerror=error.strerror,
            ) from error
        except UnicodeDecodeError as error:
            raise UsageError(CONFIG_UNREADABLE, "the config file is not UTF-8 text.", where=path) from error
        return cls.loads(text, str(path), quality)

    @classmethod
    def loads(cls: type[S], text: str, where: str = "config", quality: str | None = None) -> S:
        """Parse TOML text like `load`; messages begin with `where`."""
        try:
            data = parse_toml(text)
        except ValueError as error:
            raise UsageError(
                CONFIG_UNREADABLE, "this is not TOML ({error}).", where=where, error=error
            ) from error
        named = data.pop("quality", None) if cls.QUALITIES else None
        try:
            config = cls() if named is None else cls.from_quality(named)
        except UsageError as error:
            raise UsageError.from_diagnostic(error.diagnostic.replace_location_fields(file=where)) from error
        if quality is not None:
            config = cls.from_quality(quality)
        for section, values in data.items():
            _require_section(section, cls.get_types(), where)
            if not isinstance(values, dict):
                raise UsageError(
                    CONFIG_UNREADABLE,
                    "{section} is a section",
                    remedy="write [{section}], its parameters below.",
                    where=where,
                    section=section,
                )
            config = config._apply_values(section, values, where)
        return config

    def set(self: S, assignments: Iterable[str]) -> S:
        """Return the configuration with words `section.parameter=value` applied; see `read_assignments`."""
        config = self
        for one in read_assignments(assignments, self.get_types()):
            config = config._apply_values(one.section, one.changes, None)
        return config

    def dumps(self) -> str:
        """Write every parameter as commented TOML that `loads` reads back to the same configuration."""
        return "\n".join(section_toml(name, getattr(self, name)) for name in self.get_types())

    def get(self, kind: type[P]) -> P:
        """Return the first section with parameters of a class."""
        return next(params for name in self.get_types() if isinstance(params := getattr(self, name), kind))

    def to_canonical(self, section: str) -> dict[str, Any]:
        """Return the result-relevant parameters of a section as JSON values, for the cache key.

        Raises
        ------
        UsageError
            If a value is infinite, which JSON cannot express.
        """
        return _canonicalise(getattr(self, section), section)

    def _apply_values(self: S, section: str, values: Mapping[str, Any], where: str | None) -> S:
        changes = _convert_section(values, section, self.get_types(), where)
        with located(section, where):
            changed = apply_changes(getattr(self, section), changes)
        return dataclasses.replace(self, **{section: changed})  # type: ignore[type-var]


@dataclasses.dataclass(frozen=True)
class Assignment:
    """One parameter and its new value, from words `section.parameter=value`.

    Attributes
    ----------
    section, name : the parameter, such as `simplify` and `planar.crease_angle`.
    changes : the value under the parameter's name, in mappings for nested sections.
    """

    section: str
    name: str
    changes: Mapping[str, Any]


def read_assignments(assignments: Iterable[str], types: Mapping[str, type]) -> Iterator[Assignment]:
    """Parse assignments `section.parameter=value`.

    The value `none` resets a parameter, so that it is derived from the data. Types are checked here. Texts
    that are not numbers, and ranges, are checked by `apply_changes`.

    Parameters
    ----------
    types : parameter class of every known section.

    Raises
    ------
    UsageError
        For malformed assignments, and for unknown sections and parameters.
    """
    for assignment in assignments:
        key, equals, text = (part.strip() for part in assignment.partition("="))
        section, dot, name = key.partition(".")
        if not (equals and dot and section and name):
            raise UsageError(
                CONFIG_UNREADABLE,
                "--set {assignment}: write section.parameter=value, such as fuse.voxel_size=0.01.",
                assignment=assignment,
            )
        where = f"--set {assignment}"
        _require_section(section, types, where)
        yield Assignment(section, name, _nest_value([section], name, types[section], text, types, where))


@contextmanager
def located(section: str, where: str | None = None) -> Iterator[None]:
    """Name section and file in errors about a parameter."""
    try:
        yield
    except UsageError as error:
        raise UsageError.from_diagnostic(
            error.diagnostic.replace_location_fields(section=section, file=where)
        ) from error


def _require_section(section: str, types: Mapping[str, type], where: str) -> None:
    if section not in types:
        raise UsageError(
            CONFIG_PARAMETER_UNKNOWN,
            "there is no section {section!r}; {advice}",
            where=where,
            section=section,
            advice=_suggest_name(section, types),
        )


def _get_kind(section: str, key: str, cls: type, types: Mapping[str, type], where: str | None) -> Any:
    """Return the type of a parameter of a section."""
    if key in find_nested(cls):
        raise _make_section_error(f"{section}.{key}", where)
    if key not in describe_own(cls):
        raise UsageError(
            CONFIG_PARAMETER_UNKNOWN,
            "{section} has no parameter {key!r}; {advice}",
            where=where,
            section=section,
            key=key,
            advice=_suggest_key(section, key, cls, types),
        )
    return resolve_hints(cls)[key]


def _suggest_key(section: str, key: str, cls: type, types: Mapping[str, type]) -> str:
    """Return advice for a parameter that a section does not have: keys of the same or a similar name."""
    known = list(describe_all(cls))
    word = key.rpartition(".")[2]
    similar = [name for name in known if name.endswith(f".{word}")]
    similar = similar or difflib.get_close_matches(key, [*known, *find_nested(cls)], n=3)
    equal = [f"{other}.{word}" for other, its in types.items() if word in describe_all(its)]
    keys = list(dict.fromkeys([*(f"{section}.{name}" for name in similar), *equal]))
    if not keys:
        return f"known are {', '.join([*describe_own(cls), *find_nested(cls)])}."
    *others, last = keys[:4]
    return f"did you mean {', '.join(others) + ' or ' if others else ''}{last}?"


def _make_section_error(section: str, where: str | None) -> UsageError:
    return UsageError(
        CONFIG_UNREADABLE,
        "{section} is a section",
        remedy="write [{section}], its parameters below.",
        where=where,
        section=section,
    )


def _convert_section(
    values: Mapping[str, Any], section: str, types: Mapping[str, type], where: str | None
) -> dict[str, Any]:
    """Return values of a section with the types of its parameters, and nested sections as mappings."""
    return _convert(values, section, types[section], types, where)


def _convert(
    values: Mapping[str, Any], section: str, cls: type, types: Mapping[str, type], where: str | None
) -> dict[str, Any]:
    typed = {}
    for key, value in values.items():
        nested = find_nested(cls).get(key)
        if nested is None:
            typed[key] = _convert_value(value, _get_kind(section, key, cls, types, where))
        elif isinstance(value, Mapping):
            typed[key] = _convert(value, f"{section}.{key}", nested, types, where)
        else:
            raise _make_section_error(f"{section}.{key}", where)
    return typed


def _nest_value(
    sections: list[str], key: str, cls: type, text: str, types: Mapping[str, type], where: str
) -> dict[str, Any]:
    """Parse the text of a parameter whose key may name nested sections.

    Returns nested mappings for a dotted key: `planar.patch_angle` gives {"planar": {"patch_angle": value}}.
    """
    first, dot, rest = key.partition(".")
    nested = find_nested(cls).get(first)
    if dot and nested is not None:
        return {first: _nest_value([*sections, first], rest, nested, text, types, where)}
    if key in describe_own(cls) and describe_own(cls)[key].unit == "m":
        with suppress(ValueError):
            return {key: parse_length(text)}
    return {key: _read_value(text, _get_kind(".".join(sections), key, cls, types, where))}


def _suggest_name(word: str, known: Iterable[str]) -> str:
    names = list(known)
    near = difflib.get_close_matches(word, names, n=1)
    return f"did you mean {near[0]}?" if near else f"known are {', '.join(names)}."


def _is_optional(hint: Any) -> bool:
    return type(None) in get_args(hint)


def _convert_value(value: Any, hint: Any) -> Any:
    # TOML integers are accepted for floats; 1 and 1.0 must give the same cache key.
    if float in get_allowed_types(hint) and type(value) is int:
        return float(value)
    if get_row_length(hint) and isinstance(value, (list, tuple)):
        return tuple(_convert_value(number, float) for number in value)
    return Path(value) if Path in get_allowed_types(hint) and isinstance(value, str) else value


def _read_value(text: str, hint: Any) -> Any:
    """Return the value that text is for a parameter's type; text of another form as it is."""
    if text.lower() == "none" and _is_optional(hint):
        return None
    kinds = get_allowed_types(hint)
    if get_row_length(hint):
        return tuple(_parse_number(word) for word in re.split(r"[\s,]+", text.strip("[]() ")))
    if bool in kinds and text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for kind in (int, float):
        if kind in kinds:
            try:
                return kind(text)
            except ValueError:
                continue
    return text


def _parse_number(word: str) -> Any:
    # Text that is not a number is rejected with the other range checks of the parameter.
    try:
        return float(word)
    except ValueError:
        return word


def _canonicalise(params: Any, section: str) -> dict[str, Any]:
    """Return the result-relevant parameters as JSON values; nested sections become objects."""
    cls = type(params)
    hints = resolve_hints(cls)
    values: dict[str, Any] = {
        name: _canonicalise_value(getattr(params, name), hints[name], f"{section}.{name}")
        for name, about in describe_own(cls).items()
        if about.invalidates
    }
    for name in find_nested(cls):
        values[name] = _canonicalise(getattr(params, name), f"{section}.{name}")
    return values


def _canonicalise_value(value: Any, hint: Any, where: str) -> Any:
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        raise UsageError(
            USAGE_VALUE_INVALID, "{place} is infinite", remedy="give a number, or leave it out.", place=where
        )
    if isinstance(value, Path):
        raise TypeError(f"{where} is a path; a result must depend on the file's content, not on its name")
    typed = _convert_value(value, hint)
    if isinstance(typed, tuple):
        return [number + 0.0 for number in typed]
    return typed + 0.0 if isinstance(typed, float) else typed  # converts -0.0 to 0.0


def section_toml(
    name: str, params: Any, *, is_shown: Callable[[ParameterInfo], bool] = lambda _: True
) -> str:
    """Write the parameters of a section as commented TOML, or only those that are to be shown."""
    summary = (type(params).__doc__ or "").strip().split("\n")[0]
    lines = [f"[{name}]", *_format_comment(summary)]
    hints = resolve_hints(type(params))
    for key, about in describe_own(type(params)).items():
        if not is_shown(about):
            continue
        default = get_default(type(params), key)
        lines += [
            "",
            *_format_comment(about.text),
            *_format_comment(describe_parameter(about, default, hints[key])),
        ]
        value = getattr(params, key)
        lines.append(f"# {key} =" if value is None else f"{key} = {_format_value(value)}")
    nested = [
        section_toml(f"{name}.{key}", getattr(params, key), is_shown=is_shown)
        for key, cls in find_nested(type(params)).items()
        if any(map(is_shown, describe_all(cls).values()))
    ]
    return "\n".join(["\n".join(lines) + "\n", *nested])


@cache
def _format_comment(text: str) -> Sequence[str]:
    return tuple(textwrap.wrap(text, 100, initial_indent="# ", subsequent_indent="# "))


def describe_parameter(about: ParameterInfo, default: Any, hint: Any) -> str:
    """Return kind, unit, range and default of a parameter in words; `hint` is its type."""
    kind = f"one of {', '.join(about.choices)}" if about.choices else describe_kinds(get_allowed_types(hint))
    facts = [f"{kind} in {about.unit}" if about.unit else kind]
    if about.low is not None:
        facts.append(f"{'more than' if about.low_open else 'at least'} {about.low:g}")
    if about.high is not None:
        facts.append(f"at most {about.high:g}")
    facts.append("not set by default" if default is None else f"default: {_format_value(default)}")
    return "; ".join(facts)


def _format_value(value: Any) -> str:
    # TOML strings, numbers and booleans use JSON syntax, except for infinities.
    if isinstance(value, float) and value in (float("inf"), float("-inf")):
        return "inf" if value > 0 else "-inf"
    text = json.dumps(str(value) if isinstance(value, Path) else value, ensure_ascii=False)
    return text.replace("\x7f", "\\u007f")  # the only character that JSON allows unescaped and TOML does not
