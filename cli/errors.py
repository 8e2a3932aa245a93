"""Conversion of exceptions to a message and an exit code."""

from __future__ import annotations

import errno
from dataclasses import dataclass

import typer

from scanloom.cli.codes import USAGE_OPTION_INVALID
from scanloom.cli.exit_codes import BAD_INPUT, FAILED, INTERRUPTED, WRONG_USAGE
from scanloom.cli.help import HelpCommand
from scanloom.cli.interrupts import SENTENCE
from scanloom.cli.rendering import render
from scanloom.stages.diagnostics.codes import MACHINE_BUG, MACHINE_DISK_FAILED, MACHINE_OUT_OF_MEMORY
from scanloom.stages.diagnostics.diagnostic import Code, Diagnostic
from scanloom.stages.diagnostics.errors import (
    InputError,
    ScanloomError,
    UsageError,
    format_bug_report,
    is_out_of_memory,
)
from scanloom.stages.files.codes import FILE_PATH_INVALID

# Base class of typer's exceptions for a wrong command line, which has no public name.
TyperUsageError: type[Exception] = next(k for k in typer.BadParameter.__mro__ if k.__name__ == "UsageError")

# Operating system errors that another path or permission resolves. Others are errors of the machine.
_PATH_ERRORS = {
    errno.ENOENT: "there is no such file or folder",
    errno.EACCES: "the permission is missing",
    errno.EPERM: "the permission is missing",
    errno.EISDIR: "this is a folder, not a file",
    errno.ENOTDIR: "this is not a folder",
    errno.ENAMETOOLONG: "the name is too long for this file system",
    errno.EROFS: "this file system cannot be written to",
    errno.ELOOP: "the link leads to itself",
    errno.ENOTEMPTY: "this folder is not empty",
}
_MACHINE_ERRORS = {
    errno.ENOSPC: "the disk is full; free some space and run again",
    errno.EDQUOT: "the disk quota is used up; free some space and run again",
    errno.EMFILE: "too many files are open; raise the limit with ulimit -n",
    errno.EIO: "the disk or its connection failed",
}


_EXIT_CODES = {UsageError: WRONG_USAGE, InputError: BAD_INPUT}


@dataclass(frozen=True)
class Failure:
    """Sentence and exit code of a failed command."""

    sentence: str
    exit_code: int
    diagnostic: Diagnostic | None = None


def explain_failure(error: BaseException) -> Failure:
    """Return the sentence and exit code of an exception that ended a command."""
    if isinstance(error, (KeyboardInterrupt, typer.Abort)):
        return Failure(SENTENCE, INTERRUPTED)
    if isinstance(error, TyperUsageError):
        return _failure(USAGE_OPTION_INVALID, WRONG_USAGE, _usage_sentence(error))
    if isinstance(error, ScanloomError):
        code = next((code for kind, code in _EXIT_CODES.items() if isinstance(error, kind)), FAILED)
        return Failure(render(error.diagnostic), code, error.diagnostic)
    if is_out_of_memory(error):
        advice = "choose a larger voxel size, or run on a machine with more memory"
        return _failure(MACHINE_OUT_OF_MEMORY, FAILED, f"There is not enough memory; {advice}.")
    if isinstance(error, OSError):
        return _system_failure(error)
    return Failure(str(error), FAILED)


def explain_bug(error: BaseException) -> Failure:
    """Return the failure for an unexpected exception."""
    return _failure(MACHINE_BUG, FAILED, format_bug_report(error))


def _usage_sentence(error: Exception) -> str:
    message = str(error.format_message()).rstrip()  # type: ignore[attr-defined]
    if not message.endswith((".", "?", "!")):
        message += "."
    context = getattr(error, "ctx", None)
    option = getattr(error, "option_name", None)
    command = getattr(context, "command", None)
    if option is not None and isinstance(command, HelpCommand):
        keys = command.find_keys(option)
        if keys:
            message = f"No such option: {option}; use {' or '.join(f'--set {key}=VALUE' for key in keys)}."
    where = context.command_path if context is not None else "scanloom"
    return f"{message} See `{where} --help`."


def _system_failure(error: OSError) -> Failure:
    if error.errno in _PATH_ERRORS:
        return _failure(FILE_PATH_INVALID, BAD_INPUT, f"{_PATH_ERRORS[error.errno]}.", error.filename)
    reason = _MACHINE_ERRORS.get(error.errno or 0, error.strerror or str(error))
    return _failure(MACHINE_DISK_FAILED, FAILED, f"{reason}.", error.filename)


def _failure(code: Code, exit_code: int, message: str, file: str | None = None) -> Failure:
    diagnostic = code.error(message, file)
    return Failure(render(diagnostic), exit_code, diagnostic)
