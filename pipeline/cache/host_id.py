"""Host identifier in names of cache drafts.

In a shared cache, locks may only hold within one machine.
"""

from __future__ import annotations

import functools
import hashlib
import re
import socket

_DRAFT_NAME = re.compile(r"[^-]+-m([0-9a-f]{8})-")


@functools.cache
def get_host_id() -> str:
    """Return the host identifier used in names of drafts."""
    return "m" + hashlib.sha256(socket.gethostname().encode("utf-8", "replace")).hexdigest()[:8]


def is_from_another_host(name: str) -> bool:
    """Return True if the name of a draft has the identifier of another host."""
    found = _DRAFT_NAME.match(name)
    return found is not None and f"m{found[1]}" != get_host_id()
