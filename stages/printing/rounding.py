"""Directed rounding, so that printed bounds remain valid."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

PRINTED_DIGITS = 4


def round_up(value: float, digits: int = PRINTED_DIGITS) -> float:
    """Round up to `digits` significant digits; for upper bounds."""
    return _round_to_digits(value, digits, ROUND_CEILING)


def round_down(value: float, digits: int = PRINTED_DIGITS) -> float:
    """Round down to `digits` significant digits; for attained values."""
    return _round_to_digits(value, digits, ROUND_FLOOR)


def _round_to_digits(value: float, digits: int, rounding_mode: str) -> float:
    if not math.isfinite(value):
        return value
    # The shortest decimal of the float is rounded, so that 0.01 stays 0.01 although the float is slightly
    # larger.
    return float(Context(prec=digits, rounding=rounding_mode).create_decimal(Decimal(repr(float(value)))))
