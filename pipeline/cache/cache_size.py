"""Size limit of the cache, and parsing of sizes with units."""

from __future__ import annotations

import re
from dataclasses import dataclass

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param

# Decimal units, as disks are sold and as `scanloom cache ls` prints sizes.
_UNITS = {"kb": 10**3, "mb": 10**6, "gb": 10**9, "tb": 10**12}
# Megabytes, i.e. 100 TB: a larger number without a unit is meant in bytes.
_MAX_MEGABYTES_WITHOUT_UNIT = 1e8


@dataclass(frozen=True, kw_only=True)
class CacheParams:
    """Cached results of earlier runs."""

    max_size: str | None = param(
        None,
        "Maximum size of the cache, such as `20 GB`. After a run, the least recently used results are "
        "removed until the cache fits; results of the latest run of each output folder are kept. No limit by "
        "default.",
        invalidates=False,
        common=True,
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        if self.max_size is not None:
            parse_size(self.max_size, "max_size")

    @property
    def max_bytes(self) -> int | None:
        """Size limit in bytes; None for no limit."""
        return None if self.max_size is None else parse_size(self.max_size, "max_size")


def parse_size(text: str, name: str) -> int:
    """Parse a size like `20 GB` to bytes.

    A number without a unit is in MB.

    Raises
    ------
    UsageError
        If the text is not a size; the message names the parameter `name`.
    """
    found = re.fullmatch(r"\s*(\d{1,12}(?:\.\d{1,12})?)\s*([kmgt]b)?\s*", text, re.ASCII | re.IGNORECASE)
    # Reject huge numbers without a unit: they are meant in bytes, and as MB would be no limit at all.
    if found is None or (not found[2] and float(found[1]) >= _MAX_MEGABYTES_WITHOUT_UNIT):
        raise UsageError(
            USAGE_VALUE_INVALID,
            "is {text!r}; it must be a size such as 500 MB, 20 GB or 1.5 TB.",
            DiagnosticLocation(parameter=name),
            text=text[:40],
        )
    return round(float(found[1]) * _UNITS[(found[2] or "mb").lower()])
