"""Parser for a line of numbers separated by white space, commas or semicolons."""

from __future__ import annotations

import re

# Number with a decimal comma (0,7635), as spreadsheets of many locales write it.
_DECIMAL_COMMA = re.compile(r"[-+]?(?:\d*,)?\d+(?:e[-+]?\d+)?|[-+]?(?:nan|inf)", re.IGNORECASE)


def parse_number_row(line: str) -> list[float]:
    """Parse the numbers on a line.

    Commas separate numbers, as in CSV. They are decimal commas if the line has no point and every word
    between white space or semicolons is a number with at most one comma.

    Raises
    ------
    ValueError
        If the line holds anything that is not a number.
    """
    words = re.split(r"[;\s]+", line.strip(" ;\t"))
    # A single word such as `1,2` is ambiguous and read as two integers.
    if len(words) > 1 and "," in line and "." not in line and all(map(_DECIMAL_COMMA.fullmatch, words)):
        return [float(word.replace(",", ".")) for word in words]
    return [float(word) for word in re.split(r"\s*[,;]\s*|\s+", line.strip(" ;\t"))]
