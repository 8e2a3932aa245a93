"""What can go wrong, in three kinds; the command line turns each into its exit code."""

from __future__ import annotations

from pathlib import Path


class ScanloomError(Exception):
    """A failure with one plain sentence for the person who reads it."""


class InputError(ScanloomError):
    """The input cannot be used (exit code 3).

    Say what is wrong, in which file, where in it, and what to do.

    Parameters
    ----------
    message : the sentence; no file name at its start when `file` is given.
    file : the file it is about; its path is put before the message.
    """

    def __init__(self, message: str, file: Path | str | None = None) -> None:
        super().__init__(f"{file}: {message}" if file is not None else message)
        self.file = file


class MeshError(InputError):
    """A mesh breaks a rule: an index out of range, a value that is not finite, an edge of three faces."""


class UsageError(ScanloomError):
    """A parameter or option is wrong (exit code 2)."""


class StageError(ScanloomError):
    """A stage failed on input that looked sound, or the machine ran out of something (exit code 1)."""
