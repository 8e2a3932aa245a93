"""Conversion of operating system errors to StageError."""

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterator

from scanloom.stages.diagnostics.codes import MACHINE_DISK_FAILED, MACHINE_OUT_OF_MEMORY
from scanloom.stages.diagnostics.errors import StageError, is_out_of_memory

_DISK_FULL_TEXTS = {errno.ENOSPC: "the disk is full", errno.EDQUOT: "the disk quota is used up"}
# Windows errors for a file that another program has open: ERROR_ACCESS_DENIED, ERROR_SHARING_VIOLATION.
_IN_USE_ERRORS = (5, 32)
_ADVICE = "free disk space, or move the cache to another disk (SCANLOOM_CACHE)"


@contextlib.contextmanager
def convert_os_errors(what: str) -> Iterator[None]:
    """Convert OSError and out-of-memory errors to a StageError that begins with `what`."""
    try:
        yield
    except StageError as error:
        # A writer in `stages` has converted a full disk already, but does not know the remedy.
        if isinstance(error.__cause__, OSError) and error.__cause__.errno in _DISK_FULL_TEXTS:
            raise StageError(
                MACHINE_DISK_FAILED, "{what}: {reason}.", what=what, reason=_describe_error(error.__cause__)
            ) from error
        raise
    except Exception as error:
        if is_out_of_memory(error):
            raise StageError(MACHINE_OUT_OF_MEMORY, "{what}: out of memory.", what=what) from error
        if isinstance(error, OSError):
            raise StageError(
                MACHINE_DISK_FAILED, "{what}: {reason}.", what=what, reason=_describe_error(error)
            ) from error
        raise


def _describe_error(error: OSError) -> str:
    if error.errno in _DISK_FULL_TEXTS:
        return f"{_DISK_FULL_TEXTS[error.errno]}; {_ADVICE}"
    reason = error.strerror or str(error)
    if getattr(error, "winerror", None) in _IN_USE_ERRORS:
        reason = f"{reason.rstrip('.')}; another program may have the file open"
    return f"{reason} ({error.filename})" if error.filename else reason
