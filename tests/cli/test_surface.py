"""The command line stays small: few commands, few options, and a help that fits on a screen."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from typer.main import get_command

from scanloom.cli.app import app
from scanloom.cli.command_table import COMMANDS, GROUPS
from scanloom.cli.sections import all_sections
from scanloom.pipeline.config import Config

MAX_COMMANDS = 24
MAX_OPTIONS = 300
MAX_OWN_OPTIONS = 12
COMMON = {"--json", "--quiet", "--strict", "--debug", "--help"}
MAX_LINES, MAX_SUMMARY = 40, 55

Run = Callable[..., Any]


def list_commands() -> Iterator[tuple[str, Any]]:
    for name, command in get_command(app()).commands.items():  # type: ignore[attr-defined]
        if name in GROUPS:
            yield from ((f"{name} {own}", below) for own, below in command.commands.items())
        else:
            yield name, command


def list_options(command: Any) -> list[str]:
    return [one.opts[0] for one in command.params if one.param_type_name == "option"]


def test_there_are_few_commands() -> None:
    assert set(get_command(app()).commands) == {  # type: ignore[attr-defined]
        name for names in COMMANDS.values() for name in names
    }
    assert len(get_command(app()).commands) <= MAX_COMMANDS  # type: ignore[attr-defined]


def test_every_command_has_few_options() -> None:
    own = {name: set(list_options(command)) - COMMON for name, command in list_commands()}
    assert {name: few for name, few in own.items() if len(few) > MAX_OWN_OPTIONS} == {}


def test_there_are_few_options() -> None:
    count = len(list_options(get_command(app()))) + sum(
        len(list_options(command)) for _, command in list_commands()
    )
    assert count <= MAX_OPTIONS


@pytest.mark.parametrize("columns", [80, 100])
def test_the_help_fits_on_a_screen(scanloom: Run, monkeypatch: pytest.MonkeyPatch, columns: int) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    lines = scanloom("--help").stdout.splitlines()
    assert len(lines) <= MAX_LINES
    assert max(map(len, lines)) <= columns


@pytest.mark.parametrize("columns", [80, 100])
def test_the_help_of_a_command_fits_the_terminal(
    scanloom: Run, monkeypatch: pytest.MonkeyPatch, columns: int
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    for name, _ in list_commands():
        lines = scanloom(*name.split(), "--help").stdout.splitlines()
        # Examples stay on one line, so that they can be copied.
        assert [one for one in lines if len(one) > columns and not one.startswith("  scanloom ")] == []
        assert "  scanloom " in "\n".join(lines), name


def test_summaries_are_short() -> None:
    summaries = {name: command.help.split("\n")[0] for name, command in list_commands()}
    assert {name: one for name, one in summaries.items() if len(one) > MAX_SUMMARY} == {}
    assert all(one.endswith(".") for one in summaries.values())


def test_the_help_ends_with_the_command_that_lists_all_parameters(scanloom: Run) -> None:
    for name, command in list_commands():
        last = scanloom(*name.split(), "--help").stdout.splitlines()[-1]
        assert ("--set" in list_options(command)) == last.startswith(
            "Parameters for --set: scanloom config "
        ), name
        words = last.partition("scanloom config ")[2].split() if "--set" in last else []
        assert set(words) <= {*all_sections(), "--all"}


def test_config_lists_the_parameters_of_every_section(scanloom: Run) -> None:
    for section in all_sections():
        ran = scanloom("config", section)
        assert ran.exit_code == 0
        assert f"[{section}]" in ran.stdout
    # Only sections of a run can be in a configuration file.
    text = scanloom("config", *all_sections()).stdout
    assert Config.loads(text) == Config()


def test_config_prints_common_parameters(scanloom: Run) -> None:
    text = scanloom("config").stdout
    assert "voxel_size =" in text
    assert "truncation =" not in text
    assert text.splitlines()[-1].startswith("# All parameters of a section: scanloom config SECTION")
    assert Config.loads(text) == Config()
    whole = scanloom("config", "--all").stdout
    assert "truncation =" in whole
    assert Config.loads(whole) == Config()
    assert "voxel_size" in scanloom("config", "--json").json["fuse"]
    assert "truncation" in scanloom("config", "fuse", "--json").json["fuse"]
    ran = scanloom("config", "fuze")
    assert (ran.exit_code, ran.stderr) == (2, "scanloom: there is no section 'fuze'; did you mean fuse?\n")


def test_a_command_without_its_group_is_reported_with_the_group(scanloom: Run) -> None:
    ran = scanloom("certify", "a.ply", "b.ply")
    assert ran.exit_code == 2
    assert ran.stderr.startswith("scanloom: No such command 'certify'; use scanloom mesh certify.")
