"""Numbers on a line as people and their programs write them: parted by white space, commas or semicolons."""

from __future__ import annotations

import re

# 0,7635: a comma where English has a point, as spreadsheets of many countries write it.
_WITH_COMMA = re.compile(r"[-+]?(?:\d*,)?\d+(?:e[-+]?\d+)?|[-+]?(?:nan|inf)", re.IGNORECASE)


def numbers_on(line: str) -> list[float]:
    """Return the numbers on a line.

    Commas part numbers, as in CSV. Where every word between white space (or semicolons) is a number with one
    comma at most, and no point is on the line, they stand for points.

    Raises
    ------
    ValueError
        If there is something else on it.
    """
    words = re.split(r"[;\s]+", line.strip(" ;\t"))
    # Two whole numbers beside each other, `1,2`, are two numbers: alone they may be either.
    if len(words) > 1 and "," in line and "." not in line and all(map(_WITH_COMMA.fullmatch, words)):
        return [float(word.replace(",", ".")) for word in words]
    return [float(word) for word in re.split(r"\s*[,;]\s*|\s+", line.strip(" ;\t"))]
