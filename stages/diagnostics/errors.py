"""Exceptions with a diagnostic: input, usage and stage errors, each with its exit code."""

from __future__ import annotations

import errno
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scanloom.stages.diagnostics.diagnostic import Code, Diagnostic, LocationLike, Severity

if TYPE_CHECKING:
    from typing_extensions import Self

# Messages for lack of memory from the dynamic loader, Python threads and Open3D arrays. The loader's "cannot
# allocate memory in static TLS block" has another cause, hence the `$`.
_OUT_OF_MEMORY_MESSAGES = re.compile(
    "failed to map segment|cannot allocate memory$|can't start new thread|malloc failed|unable to allocate ",
    re.IGNORECASE,
)
# cv2.error.code for lack of memory, StsNoMem.
_OPENCV_NO_MEMORY = -4

# Root of the package. Its modules are free of syntax errors.
_PACKAGE_ROOT = Path(__file__).parents[2]


class ScanloomError(Exception):
    """Error with a diagnostic for the user.

    Its text is the text of the diagnostic.

    Parameters
    ----------
    code : kind of the error.
    message : complete sentence; a `str.format` template if there are values.
    where : file, frame or argument that the message refers to.
    remedy : recommended action of the user; also a template.
    values : fields of the templates.

    Attributes
    ----------
    diagnostic : code, message, remedy, location and values.
    """

    def __init__(
        self, code: Code, message: str, /, where: LocationLike = None, *, remedy: str = "", **values: Any
    ) -> None:
        self._set_diagnostic(code.create(Severity.ERROR, message, where, remedy, values))

    def _set_diagnostic(self, diagnostic: Diagnostic) -> None:
        self.diagnostic = diagnostic
        super().__init__(str(diagnostic))

    @classmethod
    def from_diagnostic(cls, diagnostic: Diagnostic) -> Self:
        """Create an error from a diagnostic."""
        error = cls.__new__(cls)
        error._set_diagnostic(diagnostic)
        return error

    def replace_location(self, where: LocationLike) -> Self:
        """Return a copy of the error with another location."""
        return self.from_diagnostic(self.diagnostic.replace_location(where))

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.diagnostic)


def _restore(kind: type[ScanloomError], diagnostic: Diagnostic) -> ScanloomError:
    return kind.from_diagnostic(diagnostic)


class InputError(ScanloomError):
    """Unusable input (exit code 3)."""


class MeshError(InputError):
    """Invalid mesh.

    For example an index out of range, a value that is not finite, or an edge with three triangles.
    """


class UsageError(ScanloomError):
    """Invalid parameter or option (exit code 2)."""


class StageError(ScanloomError):
    """Failure of a stage on valid input, or lack of a machine resource (exit code 1)."""


def format_bug_report(error: BaseException) -> str:
    """Format an unexpected exception as a request for a bug report."""
    what = f"{type(error).__name__}: {error}".rstrip(": ").replace("\n", " ")
    return f"This is a bug in scanloom ({what}). Please report it with the output of --debug."


def is_out_of_memory(error: BaseException) -> bool:
    """Return True if an exception of any library means lack of memory."""
    if isinstance(error, MemoryError):
        return True
    if isinstance(error, OSError):
        return error.errno == errno.ENOMEM
    if type(error).__module__ == "cv2":
        return getattr(error, "code", 0) == _OPENCV_NO_MEMORY
    if isinstance(error, SyntaxError):
        # Without cached bytecode, modules are compiled on import. If the parser runs out of memory, it raises
        # SyntaxError.
        return error.filename is not None and _PACKAGE_ROOT in Path(error.filename).parents
    if isinstance(error, (ImportError, RuntimeError)):
        return _OUT_OF_MEMORY_MESSAGES.search(str(error)) is not None
    return False
