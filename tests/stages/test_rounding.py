"""Rounding keeps statements true: bounds are rounded up, measured values are rounded down."""

from __future__ import annotations

from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanloom.stages.printing.rounding import round_down, round_up


@pytest.mark.parametrize(
    ("value", "down", "up"),
    [
        (0.0050001, 0.005, 0.005001),
        (19.999, 19.99, 20.0),
        (123456.0, 123400.0, 123500.0),
        (0.01, 0.01, 0.01),
        (0.3, 0.3, 0.3),
        (0.0, 0.0, 0.0),
        (float("inf"), float("inf"), float("inf")),
    ],
)
def test_to_four_digits(value: float, down: float, up: float) -> None:
    assert (round_down(value), round_up(value)) == (down, up)


@given(st.floats(0, 1e12, allow_subnormal=False), st.integers(1, 6))
def test_printed_numbers_are_rounded_in_the_requested_direction(value: float, digits: int) -> None:
    low, high = (f"{one(value, digits):.{digits}g}" for one in (round_down, round_up))
    assert float(low) <= value <= float(high)
    assert Fraction(high) - Fraction(low) <= Fraction(value) / 10 ** (digits - 1)
