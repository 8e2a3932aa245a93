"""Whether a name that stands in a file leads to a place inside a folder, on the system this runs on."""

from __future__ import annotations

import sys
from pathlib import PurePosixPath

# On Windows they lead to other folders, other drives, and to what hangs on a file beside its content.
_LEADING_AWAY = ("\\", ":") if sys.platform == "win32" else ()


def leads_inside(name: str) -> bool:
    r"""Return whether a name, its parts parted by `/`, is a path below a folder.

    It may be text from anywhere: `..` and absolute paths lead elsewhere, and on Windows `C:` and `\` do.
    """
    path = PurePosixPath(name)
    return (
        bool(path.parts)
        and not path.is_absolute()
        and ".." not in path.parts
        and "\0" not in name
        and not any(sign in name for sign in _LEADING_AWAY)
    )
