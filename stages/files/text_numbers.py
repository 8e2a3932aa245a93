"""Fast parsers for text that consists of numbers."""

from __future__ import annotations

import re
import warnings

import numpy as np
from numpy.typing import NDArray

_INTEGER_CHARACTERS = b"0123456789- \n"
# Larger integers are not exact in float64.
_MAX_EXACT_INTEGER = 2**53


def parse_numbers(text: bytes) -> NDArray[np.float64]:
    """Parse numbers separated by white space.

    Raises
    ------
    ValueError
        If a word is not a number; the message is a sentence that quotes the first one.
    """
    found = _parse_fast(text, np.float64)
    if found is not None:
        return np.asarray(found, np.float64)
    bad = next((word for word in text.split() if not _is_number(word)), b"")
    raise ValueError(f"{bad[:40].decode('latin-1')!r} is not a number.")


def parse_integers(text: bytes) -> NDArray[np.int64] | None:
    """Parse integers separated by white space.

    Returns None if a number is not an integer or exceeds 2⁵³.

    Raises
    ------
    ValueError
        If a word is not a number; the message is a sentence that quotes the first one.
    """
    # Parsing as int64 is three times as fast, but NumPy accepts `- 1` as a number.
    if not text.translate(None, _INTEGER_CHARACTERS) and not re.search(rb"-(?![0-9])", text):
        found = _parse_fast(text, np.int64)
        if found is not None and (np.abs(found) < _MAX_EXACT_INTEGER).all():
            return np.asarray(found, np.int64)
    numbers = parse_numbers(text)
    if not (np.abs(numbers) < _MAX_EXACT_INTEGER).all() or not (numbers == np.floor(numbers)).all():
        return None
    return numbers.astype(np.int64)


def _parse_fast(text: bytes, kind: type[np.generic]) -> NDArray[np.generic] | None:
    if not text.strip():
        return np.empty(0, kind)  # np.fromstring returns one number for empty text
    with warnings.catch_warnings():
        warnings.simplefilter("error", DeprecationWarning)  # NumPy 1.26 stops at a bad word with a warning
        try:
            return np.fromstring(text.decode("latin-1"), kind, sep=" ")
        except (ValueError, DeprecationWarning):
            return None


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True
