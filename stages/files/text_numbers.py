"""Numbers from text, in bulk."""

from __future__ import annotations

import warnings

import numpy as np
from numpy.typing import NDArray


def parse_numbers(text: bytes) -> NDArray[np.float64]:
    """Parse numbers separated by white space.

    Raises
    ------
    ValueError
        For the first word that is no number; the message is a sentence that quotes it.
    """
    if not text.strip():
        return np.empty(0)  # fromstring would return one number here
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy 1.26 stops at a bad word with a warning
        try:
            return np.fromstring(text.decode("latin-1"), np.float64, sep=" ")
        except (ValueError, DeprecationWarning):
            pass
    bad = next((word for word in text.split() if not _is_number(word)), b"")
    raise ValueError(f"{bad[:40].decode('latin-1')!r} stands where a number is expected.")


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
