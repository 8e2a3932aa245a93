"""How large a cache may become, in words as people write sizes."""

from __future__ import annotations

import re
from dataclasses import dataclass

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import Where
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, param

# Of a thousand each, as disks are sold and `scanloom cache ls` shows sizes.
_UNITS = {"kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12}
# Megabytes: a hundred terabytes.
_BYTES_MEANT = 1e8


@dataclass(frozen=True, kw_only=True)
class CacheParams:
    """What is kept of results of earlier runs."""

    max_size: str | None = param(
        None,
        "Size of the cache, such as `20 GB`, down to which results that were unused longest are removed "
        "after a run; never those that the latest run of an output folder used. Without it all is kept.",
        invalidates=False,
        common=True,
    )

    def __post_init__(self) -> None:
        check(self)
        if self.max_size is not None:
            bytes_of(self.max_size, "max_size")

    @property
    def max_bytes(self) -> int | None:
        """Return the size in bytes; None for no limit."""
        return None if self.max_size is None else bytes_of(self.max_size, "max_size")


def bytes_of(text: str, name: str) -> int:
    """Return a size like `20 GB` in bytes; a number alone is in MB.

    Raises
    ------
    UsageError
        If it is no size; `name` says whose.
    """
    found = re.fullmatch(r"\s*(\d{1,12}(?:\.\d{1,12})?)\s*([kmgt]b)?\s*", text, re.ASCII | re.IGNORECASE)
    # Who writes so much without a unit means bytes, and would have no limit at all.
    if found is None or (not found[2] and float(found[1]) >= _BYTES_MEANT):
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {text!r}; it must be a size such as 500 MB, 20 GB or 1.5 TB.",
            Where(parameter=name),
            text=text[:40],
        )
    return round(float(found[1]) * _UNITS[(found[2] or "mb").lower()])
