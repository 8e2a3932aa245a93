"""Numbers for people, rounded so that what is said of them stays true."""

from __future__ import annotations

import math
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal

DIGITS = 4


def rounded_up(value: float, digits: int = DIGITS) -> float:
    """Return the least number of so many digits that is not below `value`: for bounds."""
    return _rounded(value, digits, ROUND_CEILING)


def rounded_down(value: float, digits: int = DIGITS) -> float:
    """Return the greatest number of so many digits that is not above `value`: for what was found."""
    return _rounded(value, digits, ROUND_FLOOR)


def _rounded(value: float, digits: int, how: str) -> float:
    if not math.isfinite(value):
        return value
    # By the shortest decimal that is read as this float: a bound of 0.01 is 0.01, though the float is
    # a little more than that.
    return float(Context(prec=digits, rounding=how).create_decimal(Decimal(repr(float(value)))))
