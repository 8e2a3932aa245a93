"""Write a file beside its place and move it there whole."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stages.errors import StageError


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a temporary path in the folder of `path`; it takes the name of `path` when the block ends well.

    Whatever happens, a reader finds the old file, the new one or none, never a part.

    Raises
    ------
    StageError
        If the system refuses to write: no such folder, no permission, no space.
    """
    part = path.with_name(f".{path.name}.{secrets.token_hex(4)}.part")
    try:
        try:
            yield part
            with part.open("rb+") as file:
                os.fsync(file.fileno())
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)
    except OSError as error:
        raise StageError(f"{path}: cannot be written: {error.strerror or error}.") from error
