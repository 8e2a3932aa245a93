"""Command lines, options and keys in pages, help texts, messages and scripts exist and can be parsed."""

from __future__ import annotations

import re
import shlex
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from scanloom.cli.app import app
from scanloom.cli.command_table import GROUPS, iterate_commands, load_command
from scanloom.cli.options import set_sections
from scanloom.cli.sections import all_sections
from scanloom.pipeline.config import Config
from scanloom.pipeline.sections import read_assignments
from scanloom.stages.params import describe_all

ROOT = Path(__file__).resolve().parents[2]
PAGES = ("README.md", "CONTRIBUTING.md", "samples/README.md")
# Measurements of earlier versions, with the command lines of those versions.
HISTORY = ("measured.md",)
COMMANDS = {" ".join(words): words for words in iterate_commands()}
# A word after "scanloom" that is listed here must be part of a command.
WORDS = {word for words in COMMANDS.values() for word in words} | set(GROUPS)
# Options of other programs on pages.
OTHERS = {
    *("--again", "--visitor", "--warp", "--frames", "--seed", "--truth", "--reach"),  # of scripts
    *("--cores", "--nthreads", "--executor", "--default-resources", "--keep-going"),  # Dask and Snakemake
}


def list_pages() -> list[Path]:
    docs = [path for path in sorted((ROOT / "docs").rglob("*.md")) if path.name not in HISTORY]
    return [*(ROOT / page for page in PAGES), *docs]


def get_relative_name(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def find_code(text: str) -> Iterator[str]:
    """Yield the lines of code blocks and the inline code of a page."""
    blocks = re.findall(r"^ *```[^\n]*\n(.*?)^ *```", text, flags=re.MULTILINE | re.DOTALL)
    for block in blocks:
        yield from block.splitlines()
    outside = re.sub(r"^ *```.*?^ *```", "", text, flags=re.MULTILINE | re.DOTALL)
    # Inline code may continue on the next line.
    yield from (" ".join(span.split()) for span in re.findall(r"`([^`]+)`", outside))


@cache
def build_parser() -> Any:
    return get_command(app())


@cache
def get_command_parser(name: str) -> Any:
    command = build_parser()
    for word in COMMANDS[name]:
        command = command.commands[word]
    return command


def list_options(command: Any) -> set[str]:
    return {one for parameter in command.params for one in (*parameter.opts, *parameter.secondary_opts)}


@cache
def get_sections(name: str) -> dict[str, type]:
    return set_sections(load_command(COMMANDS[name]))


def parse_line(line: str) -> None:
    """Parse a command line and its --set assignments without running the command."""
    words = [word for word in shlex.split(line, comments=True) if word not in (";", "\\")][1:]
    name = " ".join(words[:2]) if words[0] in GROUPS else words[0]
    assert name in COMMANDS, line
    # Check only the first command of a pipeline.
    rest = words[len(COMMANDS[name]) :]
    ends = [rest.index(word) for word in (">", "|", "&&", "2>") if word in rest]
    context = get_command_parser(name).make_context(line, list(rest[: min(ends)] if ends else rest))
    list(read_assignments(context.params.get("set_words") or (), get_sections(name)))


def find_mistakes(text: str) -> Iterator[str]:
    """Yield errors in the commands, options and keys that occur in a text."""
    for found in re.finditer(r"\bscanloom ([a-z]+)(?: ([a-z]+))?((?:(?!scanloom )[^\n`;])*)", text):
        word, below, rest = found.groups()
        if word not in WORDS:
            continue
        name = f"{word} {below}" if word in GROUPS else word
        if name not in COMMANDS:
            if word in GROUPS and not below:
                continue
            yield f"no command: {found[0]}"
            continue
        command = get_command_parser(name)
        options = list_options(command)
        for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest):
            if option not in options | {"--help"}:
                yield f"{name} has no option {option}: {found[0]}"
        yield from find_key_mistakes(rest, get_sections(name))


def find_key_mistakes(text: str, sections: dict[str, type]) -> Iterator[str]:
    for section, key in re.findall(r"--set ([a-z_0-9]+)\.([a-z_0-9.]*[a-z_0-9])", text):
        if section == "section":
            continue
        if section not in sections or key not in describe_all(sections[section]):
            yield f"no parameter {section}.{key}: {text}"


@pytest.mark.parametrize("page", list_pages(), ids=get_relative_name)
def test_commands_and_options_of_a_page_exist(page: Path) -> None:
    known = {one for name in COMMANDS for one in list_options(get_command_parser(name))}
    known |= list_options(build_parser()) | {"--help"} | OTHERS
    # Include the sections that only single commands have.
    anywhere: dict[str, list[type]] = {name: [cls] for name, cls in Config.get_types().items()}
    for name in COMMANDS:
        for section, cls in get_sections(name).items():
            anywhere.setdefault(section, []).append(cls)
    wrong = []
    for line in find_code(page.read_text(encoding="utf-8")):
        wrong += find_mistakes(line)
        if re.search(r"scanloom |\b(python|pytest|docker|pip|make|benches|dask|snakemake)\b", line):
            continue
        if line.startswith("--"):
            wrong += [one for one in re.findall(r"(?<![\w-])--[a-z][a-z-]*", line) if one not in known]
        for section, key in re.findall(r"--set ([a-z_0-9]+)\.([a-z_0-9.]*[a-z_0-9])", line):
            if section != "section" and not any(
                key in describe_all(cls) for cls in anywhere.get(section, [])
            ):
                wrong.append(f"no parameter {section}.{key}")
    assert wrong == []


@pytest.mark.parametrize("name", COMMANDS)
def test_examples_in_the_help_can_be_parsed(name: str) -> None:
    text = get_command_parser(name).help
    examples = re.findall(r"^Example: (scanloom [^\n]+)", text, flags=re.MULTILINE)
    assert examples
    for example in examples:
        parse_line(example)
    assert list(find_mistakes(text)) == []


def test_commands_and_options_in_messages_exist() -> None:
    wrong = {}
    for room in ("cli", "pipeline", "stages"):
        for path in (ROOT / room).rglob("*.py"):
            # Join adjacent string literals.
            text = re.sub(r"\"\n\s*f?\"", "", path.read_text(encoding="utf-8"))
            if found := list(find_mistakes(text)):
                wrong[get_relative_name(path)] = found
    assert wrong == {}


def test_keys_in_messages_exist() -> None:
    """Messages contain keys literally, as `section.parameter=…`."""
    known = all_sections()
    wrong = []
    for room in ("pipeline", "stages"):
        for path in (ROOT / room).rglob("*.py"):
            text = re.sub(r"\"\n\s*f?\"", "", path.read_text(encoding="utf-8"))
            for section, key in re.findall(r"[\"`( ]([a-z]+)\.([a-z_0-9.]+)=[\w{<']", text):
                if section in Config.get_types() and key not in describe_all(known[section]):
                    wrong.append((get_relative_name(path), f"{section}.{key}"))
    assert [one for one in wrong if not re.search(r"np|self|cfg", one[1])] == []


def test_command_lines_of_comparisons_can_be_parsed(
    shared_data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(ROOT / "benches")
    monkeypatch.delitem(sys.modules, "outputs", raising=False)
    from outputs.jobs import list_jobs

    for job in list_jobs(shared_data):
        for step in job.steps:
            words = shlex.split(step)
            # Skip Python snippets and intentionally wrong words.
            if words and not words[0].endswith(".py") and not job.name.startswith("words/"):
                parse_line(f"scanloom {step}")


@pytest.mark.parametrize("script", [".github/workflows/wheels.yml", "Makefile", "Dockerfile"])
def test_commands_and_options_in_scripts_exist(script: str) -> None:
    assert list(find_mistakes((ROOT / script).read_text(encoding="utf-8"))) == []
