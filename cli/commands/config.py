"""Command `config`."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanloom.cli.output import Output
from scanloom.cli.quality_option import QualityOption, format_quality, load_config
from scanloom.cli.sections import all_sections, command_sections, complete_sections
from scanloom.pipeline.sections import section_toml
from scanloom.stages.diagnostics.codes import CONFIG_PARAMETER_UNKNOWN
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import ParameterInfo, describe_all

if TYPE_CHECKING:
    from scanloom.pipeline.config import Config


def config(
    out: Output,
    sections: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SECTION]...",
            help="Print all parameters of these sections, such as fuse.",
            autocompletion=complete_sections,
            show_default=False,
        ),
    ] = None,
    all_parameters: Annotated[
        bool, typer.Option("--all", help="Print all parameters of all sections of a run.")
    ] = False,
    file: Annotated[
        Path | None,
        typer.Option(
            "--check", metavar="FILE", help="Check this file, and print its values.", show_default=False
        ),
    ] = None,
    quality: QualityOption = None,
) -> None:
    """Print parameters with unit, range, default and meaning.

    The output is TOML for --config. Without a section, the common parameters of each section are printed;
    others keep their defaults. Every parameter can also be set with --set SECTION.KEY=VALUE.

    Example: scanloom config > my.toml

    Example: scanloom config fuse
    """
    configuration = load_config(file, quality)
    names = _require_sections(sections or [])
    parts: list[str] = []
    metrics: dict[str, Any] = {}
    if all_parameters or not names:
        parts, metrics = _run_sections(configuration, is_whole=all_parameters or file is not None)
        names = [name for name in names if name not in metrics]
    parts += [text for name in names for text in _section_texts(configuration, name)]
    metrics |= {name: _values(configuration, name) for name in names}
    if quality is not None and (all_parameters or not names):
        parts.insert(0, format_quality(quality).rstrip())
    out.result(metrics, "\n\n".join(parts))


def _run_sections(configuration: Config, *, is_whole: bool) -> tuple[list[str], dict[str, Any]]:
    """Return the sections of a run as TOML and as values; only common parameters if not `is_whole`."""
    parts, values, others = [], {}, []
    for name in configuration.get_types():
        params = getattr(configuration, name)
        if is_whole:
            parts.append(section_toml(name, params).rstrip())
            values[name] = asdict(params)
        elif common := _common_names(type(params)):
            parts.append(section_toml(name, params, is_shown=_is_common).rstrip())
            values[name] = {one: getattr(params, one) for one in common}
        else:
            others.append(name)
    if not is_whole:
        more = f"; sections without common ones: {', '.join(others)}" if others else ""
        parts.append(f"# All parameters of a section: scanloom config SECTION{more}")
    return parts, values


def _is_common(about: ParameterInfo) -> bool:
    return about.common


def _is_one_of(shown: Sequence[ParameterInfo], about: ParameterInfo) -> bool:
    return any(about is one for one in shown)


def _common_names(cls: type) -> list[str]:
    return [name for name, about in describe_all(cls).items() if about.common and "." not in name]


def _section_texts(configuration: Config, name: str) -> list[str]:
    """Return all parameters of a section as TOML; parameters of commands become comments."""
    texts = []
    if name in configuration.get_types():
        texts.append(section_toml(name, getattr(configuration, name)).rstrip())
    for one in command_sections(name):
        shown = [about for key, about in describe_all(one.cls).items() if key in one.names]
        text = section_toml(name, one.cls(), is_shown=partial(_is_one_of, shown)).rstrip()
        lines = [line if line.startswith("#") or not line else f"# {line}" for line in text.split("\n")]
        texts.append("\n".join([f"# For --set of scanloom {one.command}:", *lines]))
    return texts


def _values(configuration: Config, name: str) -> Mapping[str, Any]:
    values: dict[str, Any] = {}
    for one in command_sections(name):
        values |= asdict(one.cls())
    return values | (asdict(getattr(configuration, name)) if name in configuration.get_types() else {})


def _require_sections(names: Sequence[str]) -> list[str]:
    """Return the sections, each once.

    Raises
    ------
    UsageError
        For an unknown section.
    """
    known = all_sections() if names else {}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=2)
            raise UsageError(
                CONFIG_PARAMETER_UNKNOWN,
                "there is no section {name!r}; {advice}",
                name=name,
                advice=f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(known)}.",
            )
    return list(dict.fromkeys(names))
