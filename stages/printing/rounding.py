"""Directed rounding, so that printed bounds remain valid."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

DIGITS = 4


def rounded_up(value: float, digits: int = DIGITS) -> float:
    """Round up to `digits` significant digits; for upper bounds."""
    return _rounded(value, digits, ROUND_CEILING)


def rounded_down(value: float, digits: int = DIGITS) -> float:
    """Round down to `digits` significant digits; for attained values."""
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: float, digits: int, how: str) -> float:
    if not math.isfinite(value):
        return value
    # The shortest decimal of the float is rounded, so that 0.01 stays 0.01 although the float is slightly
    # larger.
    return float(Context(prec=digits, rounding=how).create_decimal(Decimal(repr(float(value)))))
