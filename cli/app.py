"""The scanloom command: every failure ends here, as one sentence and an exit code."""

from __future__ import annotations

from scanloom.cli import interrupts

if __name__ == "__main__":
    # The imports below take a moment, in which Ctrl-C may come.
    interrupts.leave_at_once()

import functools
import io
import mmap
import os
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Annotated, Any

import typer

from scanloom.cli import errors, exit_codes
from scanloom.cli.options import with_options
from scanloom.cli.output import one_line, to_json, with_schema
from scanloom.stages import __version__
from scanloom.stages.diagnostics.errors import ScanloomError, is_lack_of_memory

# What the help lists under each heading, in this order. Each is a function in the file of its name in
# cli/commands/, imported when it is meant: all of them take twice as long as one.
COMMANDS: dict[str, tuple[str, ...]] = {
    "From scan to mesh": ("inspect", "run", "batch", "worker", "config"),
    "One stage at a time": (
        "depth",
        "register",
        "adjust",
        "fuse",
        "clean",
        "simplify",
        "replay",
        "texture",
        "bake",
        "remesh",
        "decode",
        "export",
    ),
    "Look and measure": (
        "check",
        "patches",
        "compare",
        "tradeoff",
        "certify",
        "coverage",
        "render",
        "view",
        "probe",
        "doctor",
    ),
}


@functools.cache
def app(only: str = "") -> typer.Typer:
    """Return the program with all its commands, or with one of those above alone."""
    made = typer.Typer(
        name="scanloom",
        rich_markup_mode="rich",
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    made.callback(invoke_without_command=True, help=_HELP)(scanloom)
    for panel, names in COMMANDS.items():
        for name in names:
            if only in ("", name):
                made.command(name, rich_help_panel=panel)(with_options(_function(name, name)))
    if not only:
        _add_groups(made)
    return made


def _add_groups(made: typer.Typer) -> None:
    kept = typer.Typer(rich_markup_mode="rich")
    for name in ("ls", "verify", "prune"):
        kept.command(name)(with_options(_function("cache", name), can_warn=False))
    made.add_typer(
        kept,
        name="cache",
        help="Look after the kept results of stages.",
        rich_help_panel="From scan to mesh",
    )
    levels = typer.Typer(rich_markup_mode="rich")
    for file, name in (("lod", "build"), ("lod", "info"), ("lod", "cut"), ("lod_tiles", "tiles")):
        levels.command(name)(with_options(_function(file, name)))
    made.add_typer(levels, name="lod", help="Levels of detail.", rich_help_panel="One stage at a time")


def _function(file: str, name: str) -> Callable[..., None]:
    function: Callable[..., None] = getattr(import_module(f"scanloom.cli.commands.{file}"), name)
    return function


def _meant(arguments: Sequence[str]) -> str:
    """Return the one command that words are for; nothing if they begin with anything else."""
    first = arguments[0] if arguments else ""
    return first if any(first in names for names in COMMANDS.values()) else ""


def _print_version(wanted: bool) -> None:
    if wanted:
        from scanloom.stages.inspecting.machine import kernels_build

        typer.echo(f"scanloom {__version__}\nkernels {kernels_build()}")
        raise typer.Exit


# Bytes that are asked for before words are read.
_ROOM = 16 << 20

_HELP = f"""Turn a scan folder (stereo pairs or RGB-D frames with poses) into a light, coloured mesh.

Start with: scanloom inspect FOLDER, then: scanloom run FOLDER -o OUT

Exit codes: {exit_codes.in_short()}.
"""


def scanloom(
    context: typer.Context,
    debug: Annotated[  # noqa: ARG001 - read from the command line where failures are caught
        bool, typer.Option("--debug", help="Show the traceback when something fails.")
    ] = False,
    version: Annotated[  # noqa: ARG001
        bool,
        typer.Option("--version", help="Print the version.", callback=_print_version, is_eager=True),
    ] = False,
) -> None:
    """Print the help where no command is named."""
    if context.invoked_subcommand is None:
        typer.echo(context.get_help())
        raise typer.Exit(exit_codes.WRONG_USAGE)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave with its exit code."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        # A file name need not be text, and a terminal need not know every sign: neither may end a command.
        # What other programs read is UTF-8, on Windows too, which has another encoding for pipes and files.
        is_piped_on_windows = sys.platform == "win32" and not sys.stdout.isatty()
        sys.stdout.reconfigure(encoding="utf-8" if is_piped_on_windows else None, errors="backslashreplace")
    words = sys.argv[1:] if arguments is None else arguments
    # What they are for takes a moment to import, too.
    app(_meant(words))
    try:
        interrupts.raise_interrupt()
        code = run_command(words)
        interrupts.leave_at_once()
    except KeyboardInterrupt:
        # In the moments between two handlers.
        code = _tell(errors.failure_of(KeyboardInterrupt()), None, words)
    sys.exit(code)


def run_command(arguments: Sequence[str]) -> int:
    """Run one command line; every exception becomes a sentence on stderr and an exit code."""
    with _warnings_in_a_line("--debug" in arguments):
        return _run(arguments)


@contextmanager
def _warnings_in_a_line(debug: bool) -> Iterator[None]:
    """Print warnings of libraries on stderr, one line each.

    Python's own words are several lines, and name lines of code; they are there with `debug`.
    """
    with warnings.catch_warnings():
        usual = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if debug:
                usual(message, category, *where, **more)
            else:
                sys.stderr.write(one_line(f"warning: {message}") + "\n")

        warnings.showwarning = show
        yield


def _require_room() -> None:
    """Ask for what even the smallest command takes: libraries that read words abort where memory ends."""
    try:
        mmap.mmap(-1, _ROOM).close()
    except OSError as error:
        raise MemoryError(_ROOM) from error


@functools.cache
def _reader(only: str) -> Any:
    """Return what reads the words of all commands or of one; made once, as that takes a while."""
    return typer.main.get_command(app(only))


def _run(arguments: Sequence[str]) -> int:
    try:
        _require_room()
        reader = _reader(_meant(arguments))
        code = reader.main(args=list(arguments), prog_name="scanloom", standalone_mode=False)
        sys.stdout.flush()
    except BrokenPipeError:
        return _without_reader()
    except (
        ScanloomError,
        errors.TyperUsageError,
        typer.Abort,
        KeyboardInterrupt,
        OSError,
        MemoryError,
    ) as error:
        return _tell(errors.failure_of(error), error, arguments)
    except Exception as error:
        if is_lack_of_memory(error):
            return _tell(errors.failure_of(error), error, arguments)
        bug = errors.failure_of(KeyboardInterrupt()) if interrupts.happened() else errors.bug_of(error)
        return _tell(bug, error, arguments)
    if code == exit_codes.INTERRUPTED:  # typer keeps the KeyboardInterrupt to itself
        return _tell(errors.failure_of(KeyboardInterrupt()), None, arguments)
    return code or 0


def _tell(failure: errors.Failure, error: BaseException | None, arguments: Sequence[str]) -> int:
    # The options may be what is wrong, so these two are looked up without the parser.
    if "--debug" in arguments and error is not None:
        traceback.print_exception(error)
    try:
        sys.stderr.write(one_line(f"scanloom: {failure.sentence}") + "\n")
        if "--json" in arguments:
            told = [] if failure.diagnostic is None else [failure.diagnostic.figures()]
            figures = {"error": failure.sentence, "exit_code": failure.exit_code, "diagnostics": told}
            sys.stdout.write(to_json(with_schema(figures)) + "\n")
            sys.stdout.flush()
    except BrokenPipeError:
        _without_reader()
    return failure.exit_code


def _without_reader() -> int:
    """Leave quietly when the reader of our output (head, less) has gone."""
    # Python flushes stdout once more at exit; that must not fail again.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return exit_codes.FAILED


if __name__ == "__main__":
    main()
