"""Host identifier in names of cache drafts.

In a shared cache, locks may only hold within one machine.
"""

from __future__ import annotations

import functools
import hashlib
import re
import socket

_MARKED = re.compile(r"[^-]+-m([0-9a-f]{8})-")


@functools.cache
def machine_mark() -> str:
    """Return the host identifier used in names of drafts."""
    return "m" + hashlib.sha256(socket.gethostname().encode("utf-8", "replace")).hexdigest()[:8]


def is_of_another_machine(name: str) -> bool:
    """Return True if the name of a draft has the identifier of another host."""
    found = _MARKED.match(name)
    return found is not None and f"m{found[1]}" != machine_mark()
