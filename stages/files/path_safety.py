"""Path traversal check for file names from untrusted lists, and resolution of links."""

from __future__ import annotations

import os
import sys
from pathlib import Path, PurePosixPath

# On Windows `\` and `:` lead to other folders, drives, or alternate data streams.
_FORBIDDEN_CHARACTERS = ("\\", ":") if sys.platform == "win32" else ()


def is_safe_relative_path(name: str) -> bool:
    r"""Return True if a name with `/` separators is a path below a folder.

    Absolute paths, `..` and null characters are rejected; on Windows `:` and `\` as well.
    """
    path = PurePosixPath(name)
    return (
        bool(path.parts)
        and not path.is_absolute()
        and ".." not in path.parts
        and "\0" not in name
        and not any(sign in name for sign in _FORBIDDEN_CHARACTERS)
    )


def resolve_path(path: Path | str) -> Path:
    """Return an absolute path without links.

    `Path.resolve` raises RuntimeError for a link that leads to itself; opening such a path raises OSError.
    """
    return Path(os.path.realpath(path))
