"""Lengths with a unit, such as `5mm`."""

from __future__ import annotations

# Longer names first: all of them end in m.
_PER_METRE = {"mm": 1000.0, "cm": 100.0, "m": 1.0}


def parse_length(text: str) -> float:
    """Parse a length in metres: a number, or a number with the unit `mm`, `cm` or `m`.

    Raises
    ------
    ValueError
        If the text has another form.
    """
    for unit, per_metre in _PER_METRE.items():
        if text.rstrip().endswith(unit):
            return float(text.rstrip().removesuffix(unit)) / per_metre
    return float(text)
