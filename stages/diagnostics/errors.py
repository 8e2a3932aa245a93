"""What can go wrong, in three kinds; the command line turns each into its exit code."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scanloom.stages.diagnostics.diagnostic import Code, Diagnostic, Location, Severity

if TYPE_CHECKING:
    from typing_extensions import Self

# What the system's loader says of a library it has no room for, Python of a thread, and Open3D of an array.
# The loader says "cannot allocate memory in static TLS block" where it lacks something else.
_NO_ROOM = re.compile(
    "failed to map segment|cannot allocate memory$|can't start new thread|malloc failed|unable to allocate ",
    re.IGNORECASE,
)
# OpenCV's own number for it, StsNoMem.
_OPENCV_NO_MEMORY = -4

# The folder of our own modules, which have no such error.
_OURS = Path(__file__).parents[2]


class ScanloomError(Exception):
    """Error with a diagnostic for the user; its text is that of the diagnostic.

    Parameters
    ----------
    code : kind of the error.
    message : complete sentence; with values it is a template of `str.format`.
    where : the file, frame or argument that the message is about.
    remedy : what the user can do; a template, too.
    values : fields of the templates.

    Attributes
    ----------
    diagnostic : code, message, remedy, location and values.
    """

    def __init__(
        self, code: Code, message: str, /, where: Location = None, *, remedy: str = "", **values: Any
    ) -> None:
        self._set(code.create(Severity.ERROR, message, where, remedy, values))

    def _set(self, diagnostic: Diagnostic) -> None:
        self.diagnostic = diagnostic
        super().__init__(str(diagnostic))

    @classmethod
    def of(cls, diagnostic: Diagnostic) -> Self:
        """Create the error of a diagnostic."""
        error = cls.__new__(cls)
        error._set(diagnostic)
        return error

    def at(self, where: Location) -> Self:
        """Return the error with another location."""
        return self.of(self.diagnostic.at(where))

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.diagnostic)


def _restore(kind: type[ScanloomError], diagnostic: Diagnostic) -> ScanloomError:
    return kind.of(diagnostic)


class InputError(ScanloomError):
    """The input cannot be used (exit code 3)."""


class MeshError(InputError):
    """A mesh breaks a rule: an index out of range, a value that is not finite, an edge of three triangles."""


class UsageError(ScanloomError):
    """A parameter or option is wrong (exit code 2)."""


class StageError(ScanloomError):
    """A stage failed on input that looked sound, or the machine ran out of something (exit code 1)."""


def bug_explained(error: BaseException) -> str:
    """Return what a person is told of an exception that nobody foresaw."""
    what = f"{type(error).__name__}: {error}".rstrip(": ").replace("\n", " ")
    return f"This is a bug in scanloom ({what}). Please report it with what --debug adds to the same command."


def is_lack_of_memory(error: BaseException) -> bool:
    """Whether an exception, of whatever library, says that there is not enough memory."""
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if type(error).__module__ == "cv2":
        return getattr(error, "code", 0) == _OPENCV_NO_MEMORY
    if isinstance(error, SyntaxError):
        # Python's parser, which runs where no compiled modules are kept, takes it for an error in the text.
        return error.filename is not None and _OURS in Path(error.filename).parents
    if isinstance(error, (ImportError, RuntimeError)):
        return _NO_ROOM.search(str(error)) is not None
    return False
