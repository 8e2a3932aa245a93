"""Which machine made a draft in a shared cache: locks there may hold on one machine only."""

from __future__ import annotations

import functools
import hashlib
import re
import socket

_MARKED = re.compile(r"[^-]+-m([0-9a-f]{8})-")


@functools.cache
def machine_mark() -> str:
    """Return what the names of this machine's drafts have in common."""
    return "m" + hashlib.sha256(socket.gethostname().encode("utf-8", "replace")).hexdigest()[:8]


def is_of_another_machine(name: str) -> bool:
    """Return whether the name of a draft, after its stage, has the mark of another machine."""
    found = _MARKED.match(name)
    return found is not None and f"m{found[1]}" != machine_mark()
