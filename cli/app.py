"""The program `scanloom`: run a command and convert failures to a message and an exit code."""

from __future__ import annotations

from scanloom.cli import interrupts

if __name__ == "__main__":
    # Ctrl-C may arrive during the imports below.
    interrupts.exit_on_interrupt()

import functools
import io
import mmap
import os
import sys
import traceback
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer

from scanloom.cli import errors, exit_codes
from scanloom.cli.command_table import COMMANDS, GROUPS, can_warn, has_progress, load_command
from scanloom.cli.help import HelpCommand, HelpGroup
from scanloom.cli.options import describe_set, set_sections, with_options
from scanloom.cli.output import add_schema, to_json, to_one_line
from scanloom.cli.rendering import command_line
from scanloom.cli.version import describe_version
from scanloom.stages.diagnostics.errors import ScanloomError, is_out_of_memory


@functools.cache
def app(only: str = "") -> typer.Typer:
    """Return the program with all commands, or with a single command or group."""
    program = typer.Typer(
        name="scanloom",
        cls=HelpGroup,
        rich_markup_mode=None,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    program.callback(invoke_without_command=True, help=_HELP)(scanloom)
    for names in COMMANDS.values():
        for name in names:
            if only not in ("", name):
                continue
            if name in GROUPS:
                group = GROUPS[name]
                commands = typer.Typer(cls=HelpGroup, rich_markup_mode=None)
                for own in group.files:
                    _add_command(commands, (name, own))
                program.add_typer(commands, name=name, help=group.summary)
            else:
                _add_command(program, (name,))
    return program


def _add_command(program: typer.Typer, words: tuple[str, ...]) -> None:
    function = load_command(words)
    command = with_options(function, can_warn=can_warn(words), has_progress=has_progress(words))
    about = {"hint": describe_set(function), "load_sections": functools.partial(set_sections, function)}
    help_class = type("HelpCommand", (HelpCommand,), about)
    program.command(words[-1], cls=help_class)(command)


def _first_command(arguments: Sequence[str]) -> str:
    """Return the command or group that the arguments begin with; "" for none."""
    first = arguments[0] if arguments else ""
    return first if any(first in names for names in COMMANDS.values()) else ""


def _print_version(is_wanted: bool) -> None:
    if is_wanted:
        typer.echo(describe_version())
        raise typer.Exit


# Bytes of memory that even the smallest command needs.
_MIN_MEMORY = 16 << 20

_HELP = (
    "Turn depth-camera, stereo or posed-photo scans into light, textured meshes.\n\n"
    "Start with: scanloom inspect SCAN, then: scanloom run SCAN -o OUT"
)


def scanloom(
    context: typer.Context,
    debug: Annotated[  # noqa: ARG001 - read from the command line where failures are caught
        bool, typer.Option("--debug", help="Print the traceback of a failure.")
    ] = False,
    version: Annotated[  # noqa: ARG001
        bool,
        typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    """Print the help if no command is named."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(exit_codes.WRONG_USAGE)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A file name need not be valid text, and a terminal need not have every character. Pipes and files
        # are UTF-8 for other programs; Windows has another default.
        is_piped_on_windows = sys.platform == "win32" and not sys.stdout.isatty()
        sys.stdout.reconfigure(encoding="utf-8" if is_piped_on_windows else None, errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else arguments
    # Imports take a moment, and are interrupted without a traceback.
    app(_first_command(words))
    try:
        interrupts.raise_interrupt()
        code = run_command(words)
        interrupts.exit_on_interrupt()
    except KeyboardInterrupt:
        # Ctrl-C came between two handlers.
        code = _report_failure(errors.explain_failure(KeyboardInterrupt()), None, words)
    sys.exit(code)


def run_command(arguments: Sequence[str]) -> int:
    """Run one command line; every exception becomes a sentence on stderr and an exit code."""
    with _warnings_in_a_line("--debug" in arguments), command_line():
        return _run(arguments)


@contextmanager
def _warnings_in_a_line(debug: bool) -> Iterator[None]:
    """Print warnings of libraries on stderr, one line each; unchanged with `debug`."""
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if debug:
                usual(message, category, *where, **more)
            else:
                sys.stderr.write(to_one_line(f"warning: {message}") + "\n")

        warnings.showwarning = show
        yield


def _check_memory() -> None:
    """Raise MemoryError if memory is too low for any command; argument parsers would abort."""
    try:
        mmap.mmap(-1, _MIN_MEMORY).close()
    except OSError as error:
        raise MemoryError(_MIN_MEMORY) from error


@functools.cache
def _parser(only: str) -> Any:
    """Return the parser of all commands or of one; cached, because building it is slow."""
    return typer.main.get_command(app(only))


def _run(arguments: Sequence[str]) -> int:
    try:
        _check_memory()
        parser = _parser(_first_command(arguments))
        code = parser.main(args=list(arguments), prog_name="scanloom", standalone_mode=False)
        sys.stdout.flush()
    except BrokenPipeError:
        return _leave_quietly()
    except (
        ScanloomError,
        errors.TyperUsageError,
        typer.Abort,
        KeyboardInterrupt,
        OSError,
        MemoryError,
    ) as error:
        return _report_failure(errors.explain_failure(error), error, arguments)
    except Exception as error:
        if is_out_of_memory(error):
            return _report_failure(errors.explain_failure(error), error, arguments)
        bug = (
            errors.explain_failure(KeyboardInterrupt())
            if interrupts.was_interrupted()
            else errors.explain_bug(error)
        )
        return _report_failure(bug, error, arguments)
    if code == exit_codes.INTERRUPTED:  # typer swallows the KeyboardInterrupt
        return _report_failure(errors.explain_failure(KeyboardInterrupt()), None, arguments)
    return code or 0


def _report_failure(failure: errors.Failure, error: BaseException | None, arguments: Sequence[str]) -> int:
    # The options may be wrong, so --debug and --json are looked up without the parser.
    if "--debug" in arguments and error is not None:
        traceback.print_exception(error)
    try:
        sys.stderr.write(to_one_line(f"scanloom: {failure.sentence}") + "\n")
        if "--json" in arguments:
            diagnostics = [] if failure.diagnostic is None else [failure.diagnostic.to_dict()]
            metrics = {"error": failure.sentence, "exit_code": failure.exit_code, "diagnostics": diagnostics}
            sys.stdout.write(to_json(add_schema(metrics)) + "\n")
            sys.stdout.flush()
    except BrokenPipeError:
        _leave_quietly()
    return failure.exit_code


def _leave_quietly() -> int:
    """Return the exit code after the reader of stdout (head, less) has closed it."""
    # Python flushes stdout once more at exit, which must not fail again.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return exit_codes.FAILED


if __name__ == "__main__":
    main()
