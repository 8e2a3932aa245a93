"""Options of a command from the parameter classes of its stages.

A command names a parameter class in its signature and gets an instance; `with_options` replaces that one
argument by an option for every field, with the field's text, unit, range and default in the help. Nothing
about a parameter is written twice.
"""

from __future__ import annotations

import functools
import inspect
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import is_dataclass
from pathlib import Path
from typing import Annotated, Any, Generic, TypeVar, get_args, get_origin, get_type_hints

import typer

from scanloom.cli.codes import MACHINE_LIBRARY_WARNING
from scanloom.cli.output import Output
from scanloom.cli.rendering import option_name
from scanloom.stages.diagnostics.collector import listening
from scanloom.stages.params import (
    Described,
    describe_all,
    described,
    find_nested,
    get_default,
    get_group,
    get_hint,
    kinds_of,
    resolve,
    row_length,
)

OUTPUT_PANEL = "Output"
P = TypeVar("P")


class Changes(dict[str, Any], Generic[P]):
    """The fields of a parameter class whose options were given, for a command whose defaults are a file's."""


JsonOption = Annotated[
    bool,
    typer.Option(
        "--json",
        help="Print one JSON object with the figures on stdout, and nothing else; "
        "after a failure it holds error and exit_code.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
QuietOption = Annotated[
    bool,
    typer.Option(
        "--quiet",
        "-q",
        help="No progress and no remarks on stderr; warnings are told all the same.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
StrictOption = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Exit code 1 if there is any warning; the result is written all the same.",
        rich_help_panel=OUTPUT_PANEL,
    ),
]
DebugOption = Annotated[
    bool,
    typer.Option("--debug", help="Show the traceback when something fails.", rich_help_panel=OUTPUT_PANEL),
]


def with_options(function: Callable[..., None], *, can_warn: bool = True) -> Callable[..., None]:
    """Turn arguments that are parameter classes, or the Output, into command-line options.

    A command ends with the exit code of its Output, which has --strict if it `can_warn`. The parameters of a
    class keep their declared defaults unless their option is given, so that a default is stated in one place
    only.
    """
    hints = get_type_hints(function, include_extras=True)
    kept: list[inspect.Parameter] = []
    generated: list[inspect.Parameter] = []
    builders: dict[str, Callable[[dict[str, Any]], Any]] = {}
    takes_output: list[str] = []
    for parameter in inspect.signature(function).parameters.values():
        hint = hints[parameter.name]
        if hint is Output:
            generated += _switches(can_warn=can_warn)
            takes_output.append(parameter.name)
        elif get_origin(hint) is Changes:
            generated += _options(get_args(hint)[0])
            builders[parameter.name] = functools.partial(given, get_args(hint)[0])
        elif isinstance(hint, type) and is_dataclass(hint):
            generated += _options(hint)
            builders[parameter.name] = functools.partial(build, hint)
        else:
            kept.append(parameter.replace(annotation=hint, kind=inspect.Parameter.KEYWORD_ONLY))

    @functools.wraps(function)
    def command(**values: Any) -> None:
        out = _output(values)
        with listening(out.report), _warnings_counted(out):
            built = {name: builder(values) for name, builder in builders.items()}
            outputs = dict.fromkeys(takes_output, out)
            function(**built, **outputs, **{parameter.name: values[parameter.name] for parameter in kept})
        if out.exit_code:
            raise typer.Exit(out.exit_code)

    command.__signature__ = inspect.Signature([*kept, *generated])  # type: ignore[attr-defined]
    command.__annotations__ = {}
    return command


def build(cls: type, values: dict[str, Any]) -> Any:
    """Build a parameter class from the options that were given (the others are None)."""
    return resolve(cls, None, _given(cls, values))


def given(cls: type[P], values: dict[str, Any]) -> Changes[P]:
    """Return the fields whose options were given, checked."""
    return Changes(_pick(build(cls, values), _given(cls, values)))


def _given(cls: type, values: dict[str, Any]) -> dict[str, Any]:
    """Return the values whose options were given; a nested class is a mapping."""
    found = {name: values[name] for name in described(cls) if values.get(name) is not None}
    below = {name: _given(own, values) for name, own in find_nested(cls).items()}
    return {**found, **{name: own for name, own in below.items() if own}}


def _pick(params: Any, names: dict[str, Any]) -> dict[str, Any]:
    """Return the values of these fields; a nested class is a mapping."""
    return {
        name: _pick(getattr(params, name), below) if isinstance(below, dict) else getattr(params, name)
        for name, below in names.items()
    }


def help_of(about: Described, default: Any) -> str:
    """Return a parameter's text with its unit, range and default, as every help and comment shows it."""
    return f"{about.text.rstrip().removesuffix('.')}. ({_facts(about, default)})"


def _facts(about: Described, default: Any) -> str:
    facts = []
    if about.unit:
        facts.append(about.unit)
    bounds = _bounds(about)
    if bounds:
        facts.append(bounds)
    if default is None:
        facts.append("no fixed default")  # the text says what then happens
    elif isinstance(default, bool):
        facts.append(f"default: {'on' if default else 'off'}")
    else:
        shown = f"{default:g}" if isinstance(default, float) else str(default)
        facts.append(f"default: {shown}")
    return "; ".join(facts)


def _bounds(about: Described) -> str:
    low, high = about.low, about.high
    if low is None and high is None:
        return ""
    if high is None:
        return f"above {low:g}" if about.low_open else f"at least {low:g}"
    if low is None:
        return f"at most {high:g}"
    return f"above {low:g} up to {high:g}" if about.low_open else f"{low:g} to {high:g}"


def _options(cls: type) -> list[inspect.Parameter]:
    """Return an option for each parameter, named after the last part of its name.

    Raises
    ------
    TypeError
        If two have the same name.
    """
    panel = f"{cls.__name__.removesuffix('Params')} parameters"
    options: dict[str, inspect.Parameter] = {}
    for name, about in describe_all(cls).items():
        own = name.rpartition(".")[2]
        if own in options:
            raise TypeError(f"{cls.__name__} has two parameters {own}")
        heading = get_group(cls, name) or panel
        options[own] = _keyword(
            own, _option(own, about, get_hint(cls, name), get_default(cls, name), heading)
        )
    return list(options.values())


def _option(name: str, about: Described, hint: Any, default: Any, panel: str) -> Any:
    kind = _plain_type(hint)
    names = [option_name(name)]
    if kind is bool:
        names = [f"{names[0]}/{option_name('no_' + name)}"]
    return Annotated[
        kind | None,
        typer.Option(
            *names,
            help=escaped(help_of(about, default)),
            metavar="|".join(about.choices) or " ".join(row_length(hint) * ["<float>"]) or None,
            autocompletion=(lambda: list(about.choices)) if about.choices else None,
            show_default=False,
            rich_help_panel=panel,
        ),
    ]


def _plain_type(hint: Any) -> Any:
    """Return the type an option is read as: that of the field without None, and the widest number."""
    kinds = kinds_of(hint)
    if row_length(hint):
        return kinds[0]
    for wide in (Path, float, int, bool, str):
        if wide in kinds:
            return wide
    raise TypeError(f"no option can be made for {hint}")


def _switches(*, can_warn: bool) -> list[inspect.Parameter]:
    options = {"as_json": JsonOption, "quiet": QuietOption, "strict": StrictOption, "debug": DebugOption}
    if not can_warn:
        del options["strict"]
    return [_keyword(name, option, default=False) for name, option in options.items()]


def _output(values: dict[str, Any]) -> Output:
    # --debug needs nothing here: what catches the failure reads it from the command line itself, since
    # a failure may come before the options are understood.
    return Output(
        as_json=values.get("as_json", False),
        quiet=values.get("quiet", False),
        strict=values.get("strict", False),
        can_warn="strict" in values,
    )


@contextmanager
def _warnings_counted(out: Output) -> Iterator[None]:
    """Report warnings of libraries, which Python shows."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        out.count(MACHINE_LIBRARY_WARNING.warning(str(message)))
        usual(message, category, *where, **more)

    warnings.showwarning = show
    try:
        yield
    finally:
        warnings.showwarning = usual


def _keyword(name: str, annotation: Any, default: Any = None) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def escaped(text: str) -> str:
    """Protect square brackets: help texts pass through rich's markup."""
    return text.replace("[", r"\[")
