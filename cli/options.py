"""Options of a command from the parameter classes of its stages.

A command names a parameter class in its signature and gets an instance. `with_options` replaces the argument
by an option for each common parameter. `--set section.parameter=value` sets all others; the name of the
argument is the section. The class declares names, texts, units, ranges and defaults.
"""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, is_dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin, get_type_hints

import typer

from scanloom.cli.codes import MACHINE_LIBRARY_WARNING
from scanloom.cli.completion import complete_assignment
from scanloom.cli.output import Output
from scanloom.cli.rendering import CommandParameters, option_name, use_parameters
from scanloom.pipeline.sections import Assignment, located, read_assignments
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import listen_to_diagnostics
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import (
    ParameterInfo,
    describe_all,
    get_allowed_types,
    get_default,
    get_hint,
    get_row_length,
    resolve,
)
from scanloom.stages.params.lengths import parse_length

SCAN_PANEL = "Scan options"
COMMON_PANEL = "Common options"
P = TypeVar("P")


class Changes(dict[str, Any], Generic[P]):
    """Parameters of a class that the user gave, for a command whose defaults are in a file."""


@dataclass(frozen=True)
class OptionsFor:
    """Annotation of a parameter class: only these parameters have options, all others only `--set`."""

    names: tuple[str, ...]


# No parameter of the class has an option.
SET_ONLY = OptionsFor(())


@dataclass(frozen=True)
class SetWords:
    """Annotation of an argument that receives the assignments of `--set` to configuration sections.

    Attributes
    ----------
    load : returns the parameters of each section; called if a word is given or completed.
    """

    load: Callable[[], Mapping[str, Any]]


@dataclass(frozen=True)
class ParameterGroup:
    """An argument of a command that is a parameter class.

    Attributes
    ----------
    section : name of the argument, and of the section in `--set`.
    is_changes : the command gets the parameters that the user gave, instead of an instance.
    only : common parameters that have options; None for all.
    """

    section: str
    cls: type
    is_changes: bool = False
    only: tuple[str, ...] | None = None

    @property
    def options(self) -> dict[str, str]:
        """Map option names to the parameters that they set."""
        names = [name for name, about in describe_all(self.cls).items() if about.common]
        if self.only is not None:
            names = [name for name in names if name in self.only]
        return {name.rpartition(".")[2]: name for name in names}


JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print the result as one JSON object on stdout.",
        rich_help_panel=COMMON_PANEL,
    ),
]
QuietOption = Annotated[
    bool,
    typer.Option(
        "--quiet",
        "-q",
        help="Print no progress; warnings are still printed.",
        rich_help_panel=COMMON_PANEL,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Exit with code 1 if there is a warning; the result is still written.",
        rich_help_panel=COMMON_PANEL,
    ),
]
DebugOption = Annotated[
    bool,
    typer.Option("--debug", help="Print the traceback of a failure.", rich_help_panel=COMMON_PANEL),
]


def with_options(
    function: Callable[..., None], *, can_warn: bool = True, has_progress: bool = True
) -> Callable[..., None]:
    """Turn arguments that are parameter classes, or the Output, into command-line options.

    A command ends with the exit code of its Output.

    Parameters
    ----------
    can_warn : the command has --strict.
    has_progress : the command has --quiet.

    Raises
    ------
    TypeError
        If two options have the same name.
    """
    hints = get_type_hints(function, include_extras=True)
    groups = {group.section: group for group in parameter_groups(function)}
    words = {name: hint.__metadata__[0] for name, hint in hints.items() if _is_set_words(hint)}
    arguments: list[inspect.Parameter] = []
    common: list[inspect.Parameter] = []
    kept: list[str] = []
    outputs: list[str] = []
    for parameter in inspect.signature(function).parameters.values():
        hint = hints[parameter.name]
        if hint is Output:
            common += _common_options(can_warn=can_warn, has_progress=has_progress)
            outputs.append(parameter.name)
        elif parameter.name in groups:
            arguments += _options(groups[parameter.name])
        elif parameter.name not in words:
            kept.append(parameter.name)
            arguments.append(parameter.replace(annotation=hint, kind=inspect.Parameter.KEYWORD_ONLY))
    reader = _AssignmentReader(tuple(groups.values()), tuple(words.values()))
    if words or _needs_set(function):
        arguments.append(_keyword("set_words", reader.option()))
    names = [one.name for one in arguments]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise TypeError(f"{function.__name__} has two options {twice[0]}")

    @functools.wraps(function)
    def command(**values: Any) -> None:
        out = _output(values)
        with listen_to_diagnostics(out.report), _count_library_warnings(out):
            assignments = reader.read(values, values.get("set_words") or ())
            built = {name: build(group, values, assignments) for name, group in groups.items()}
            built |= {
                name: reader.words_of(one, values.get("set_words") or ()) for name, one in words.items()
            }
            built |= dict.fromkeys(outputs, out)
            function(**built, **{name: values[name] for name in kept})
        if out.exit_code:
            raise typer.Exit(out.exit_code)

    command.__signature__ = inspect.Signature([*arguments, *common])  # type: ignore[attr-defined]
    command.__annotations__ = {}
    return command


def parameter_groups(function: Callable[..., None]) -> list[ParameterGroup]:
    """Return the arguments of a command that are parameter classes."""
    groups = []
    for name, hint in get_type_hints(function, include_extras=True).items():
        metadata = hint.__metadata__ if get_origin(hint) is Annotated else ()
        only = next((one.names for one in metadata if isinstance(one, OptionsFor)), None)
        cls = hint if only is None else get_args(hint)[0]
        is_changes = get_origin(cls) is Changes
        cls = get_args(cls)[0] if is_changes else cls
        if isinstance(cls, type) and is_dataclass(cls):
            groups.append(ParameterGroup(name, cls, is_changes, only))
    return groups


def describe_set(function: Callable[..., None]) -> str:
    """Return the last help line, which explains how to list parameters for `--set`, if any."""
    sections = list(dict.fromkeys(group.section for group in parameter_groups(function)))
    if any(map(_is_set_words, get_type_hints(function, include_extras=True).values())):
        # `--all` includes the section `scan`.
        sections = ["--all", *(section for section in sections if section != "scan")]
    elif not _needs_set(function):
        return ""
    return f"Parameters for --set: scanloom config {' '.join(sections)}"


def set_sections(function: Callable[..., None]) -> dict[str, type]:
    """Return the parameter class of each section that `--set` of a command takes."""
    types = {group.section: group.cls for group in parameter_groups(function)}
    for hint in get_type_hints(function, include_extras=True).values():
        if _is_set_words(hint):
            types |= {name: type(params) for name, params in hint.__metadata__[0].load().items()}
    return types


def _needs_set(function: Callable[..., None]) -> bool:
    """Check if a command has parameters without an option."""
    return any(set(describe_all(one.cls)) - set(one.options.values()) for one in parameter_groups(function))


def _is_set_words(hint: Any) -> bool:
    return get_origin(hint) is Annotated and isinstance(hint.__metadata__[0], SetWords)


@dataclass(frozen=True)
class _AssignmentReader:
    """Parser and completer of `--set` for one command."""

    groups: tuple[ParameterGroup, ...]
    words: tuple[SetWords, ...]

    def sections(self) -> dict[str, Any]:
        """Return the parameters of each section, with their defaults."""
        loaded = {name: params for one in self.words for name, params in one.load().items()}
        return {**{one.section: one.cls() for one in self.groups}, **loaded}

    def option(self) -> Any:
        def complete(incomplete: str) -> list[tuple[str, str]]:
            return complete_assignment(incomplete, self.sections())

        others = [one.section for one in self.groups]
        return Annotated[
            list[str] | None,
            typer.Option(
                "--set",
                metavar="SECTION.KEY=VALUE",
                help="Set a parameter of any section."
                if self.words
                else f"Set a parameter of {_join(others)}; may be repeated.",
                autocompletion=complete,
                show_default=False,
            ),
        ]

    def read(self, values: Mapping[str, Any], words: Sequence[str]) -> list[Assignment]:
        """Return the assignments, and let messages name parameters as the user typed them."""
        options = {
            f"{group.section}.{name}": option_name(own)
            for group in self.groups
            for own, name in group.options.items()
        }
        types = {group.section: group.cls for group in self.groups}
        parameters = CommandParameters(types, options)
        use_parameters(parameters)
        if not words:
            return []
        types |= {name: type(params) for name, params in self.sections().items()}
        assignments = list(read_assignments(words, types))
        keys = frozenset(f"{one.section}.{one.name}" for one in assignments)
        use_parameters(CommandParameters(parameters.sections, options, keys))
        for key in sorted(keys & set(options)):
            if values.get(key.rpartition(".")[2]) is not None:
                raise UsageError(
                    USAGE_OPTIONS_CONFLICT,
                    "both {option} and --set {key} are given",
                    remedy="omit one of them.",
                    option=options[key],
                    key=key,
                )
        return assignments

    def words_of(self, one: SetWords, words: Sequence[str]) -> list[str]:
        """Return the assignments to sections of the configuration."""
        known = one.load() if words else {}
        return [word for word in words if word.partition(".")[0].strip() in known]


def build(group: ParameterGroup, values: Mapping[str, Any], assignments: Sequence[Assignment] = ()) -> Any:
    """Return the parameters of a group from options (None if not given) and assignments.

    Raises
    ------
    UsageError
        For a value of a wrong type or out of range.
    """
    changes: dict[str, Any] = {}
    for own, name in group.options.items():
        if values.get(own) is not None:
            _merge(changes, _nest(name, values[own]))
    for one in assignments:
        if one.section == group.section:
            _merge(changes, one.changes)
    with located(group.section):
        params: Any = resolve(group.cls, None, changes)
    return Changes(_pick(params, changes)) if group.is_changes else params


def _nest(name: str, value: Any) -> dict[str, Any]:
    first, _, rest = name.partition(".")
    return {first: _nest(rest, value) if rest else value}


def _merge(changes: dict[str, Any], more: Mapping[str, Any]) -> None:
    """Merge changes in place, recursively for nested sections."""
    for name, value in more.items():
        if isinstance(value, Mapping):
            _merge(changes.setdefault(name, {}), value)
        else:
            changes[name] = value


def _pick(params: Any, names: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of the named parameters; nested sections as mappings."""
    return {
        name: _pick(getattr(params, name), nested) if isinstance(nested, dict) else getattr(params, name)
        for name, nested in names.items()
    }


def help_of(about: ParameterInfo, default: Any) -> str:
    """Return the help text of a parameter with unit, range and default."""
    facts = ", ".join(_facts(about, default))
    text = about.text.rstrip().removesuffix(".").replace("`", "")
    return f"{text}. [{facts}]" if facts else f"{text}."


def _facts(about: ParameterInfo, default: Any) -> Iterator[str]:
    if about.unit:
        yield about.unit
    if bounds := _bounds(about):
        yield bounds
    if isinstance(default, bool):
        yield f"default: {'on' if default else 'off'}"
    elif default is not None:
        yield f"default: {default:g}" if isinstance(default, float) else f"default: {default}"


def _bounds(about: ParameterInfo) -> str:
    low, high = about.low, about.high
    if low is None and high is None:
        return ""
    if high is None:
        return f"above {low:g}" if about.low_open else f"at least {low:g}"
    if low is None:
        return f"at most {high:g}"
    return f"above {low:g} up to {high:g}" if about.low_open else f"{low:g} to {high:g}"


def _options(group: ParameterGroup) -> list[inspect.Parameter]:
    """Return an option for each common parameter, named after the last part of its name."""
    about = describe_all(group.cls)
    # The options of a scan are the same for all commands.
    panel = SCAN_PANEL if group.section == "scan" else None
    return [
        _keyword(
            own, _option(own, about[name], get_hint(group.cls, name), get_default(group.cls, name), panel)
        )
        for own, name in group.options.items()
    ]


def _option(name: str, about: ParameterInfo, hint: Any, default: Any, panel: str | None) -> Any:
    kind = _plain_type(hint)
    names = [option_name(name)]
    if kind is bool:
        names = [f"{names[0]}/{option_name('no_' + name)}"]
    return Annotated[
        kind | None,
        typer.Option(
            *names,
            help=help_of(about, default),
            metavar=_metavar(about, hint, kind),
            parser=_parse_length if kind is float and about.unit == "m" else None,
            autocompletion=(lambda: list(about.choices)) if about.choices else None,
            show_default=False,
            rich_help_panel=panel,
        ),
    ]


def _parse_length(text: str) -> float:
    try:
        return parse_length(text)
    except ValueError:
        raise typer.BadParameter(
            f"{text!r} is not a valid float, also not with a unit (mm, cm, m)."
        ) from None


def _metavar(about: ParameterInfo, hint: Any, kind: Any) -> str | None:
    if about.choices:
        return "|".join(about.choices)
    if count := get_row_length(hint):
        return " ".join(count * ["X"])
    if about.is_path or kind is Path:
        return "FILE"
    if kind is float and about.unit == "m":
        return "LENGTH"
    return {float: "NUMBER", int: "COUNT", str: "TEXT"}.get(kind)


def _plain_type(hint: Any) -> Any:
    """Return the type of an option's value: the widest number type, without None."""
    kinds = get_allowed_types(hint)
    if get_row_length(hint):
        return kinds[0]
    for wide in (Path, float, int, bool, str):
        if wide in kinds:
            return wide
    raise TypeError(f"no option type for {hint}")


def _join(names: Sequence[str]) -> str:
    *others, last = names
    return f"{', '.join(others)} or {last}" if others else last


def _common_options(*, can_warn: bool, has_progress: bool) -> list[inspect.Parameter]:
    options = {"as_json": JsonOption, "quiet": QuietOption, "strict": StrictOption, "debug": DebugOption}
    if not can_warn:
        del options["strict"]
    if not has_progress:
        del options["quiet"]
    return [_keyword(name, option, default=False) for name, option in options.items()]


def _output(values: Mapping[str, Any]) -> Output:
    # A failure may occur before the options are parsed, so the error handler looks up --debug itself.
    return Output(
        as_json=values.get("as_json", False),
        quiet=values.get("quiet", False),
        strict=values.get("strict", False),
        can_warn="strict" in values,
    )


@contextmanager
def _count_library_warnings(out: Output) -> Iterator[None]:
    """Count warnings of libraries, which Python prints itself."""
    original = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        out.count(MACHINE_LIBRARY_WARNING.warning(str(message)))
        original(message, category, *where, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = original


def _keyword(name: str, annotation: Any, default: Any = None) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
