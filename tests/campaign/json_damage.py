"""Damage to JSON that stays valid JSON: a value, key or list that no reader expects."""

from __future__ import annotations

import json
import random
from typing import Any

# Placeholder for text that `json.dumps` does not write.
_MARK = "@@here@@"
_RAW = (
    "0",
    "-1",
    "1",
    "0.5",
    "2147483648",
    "-2147483649",
    "4294967295",
    "9223372036854775808",
    "1e300",
    "-1e300",
    "1e-300",
    "1e999",
    "NaN",
    "-Infinity",
    "9" * 5000,
    "null",
    "true",
    '""',
    '"x"',
    '"nan"',
    '"\\u0000"',
    '"\\ud800"',
    '"../../none"',
    '"' + "a" * 300 + '"',
    '"data:image/png;base64,AAAA"',
    "[]",
    "{}",
    "[[]]",
    '[0, "a", null]',
    "[" * 100_000 + "]" * 100_000,
    '{"a":' * 70 + "0" + "}" * 70,
)


def damage_json(data: bytes, draw: random.Random) -> bytes:
    """Replace, remove or repeat one value of JSON text.

    Raises
    ------
    ValueError
        If the text is not JSON, or has no value to change.
    """
    document = json.loads(data)
    places = list(_list_places(document))
    if not places:
        raise ValueError("nothing to change")
    # Named keys are preferred, because coordinates and poses are most of the values of most documents.
    holder, key = draw.choice([p for p in places if isinstance(p[1], str)] or places)
    if draw.random() < 0.3:
        holder, key = draw.choice(places)
    raw = draw.choice(_RAW)
    match draw.randrange(6):
        case 0:
            del holder[key]
        case 1 if isinstance(holder, list):
            holder[key:key] = [holder[key]] * draw.choice((1, 3, 1000))
        case 2 if isinstance(holder, dict):
            holder[draw.choice(("", "x", "\0", key * 50, key.upper()))] = holder.pop(key)
        case 3:
            _, other = draw.choice(places)
            holder[key] = other
        case _:
            holder[key] = _MARK
    return json.dumps(document).replace(f'"{_MARK}"', raw).encode()


def _list_places(value: Any) -> list[tuple[Any, Any]]:
    """List every (table or list, key or index) within a document."""
    found: list[tuple[Any, Any]] = []
    waiting = [value]
    while waiting:
        held = waiting.pop()
        keys = list(held) if isinstance(held, dict) else range(len(held)) if isinstance(held, list) else ()
        for key in keys:
            found.append((held, key))
            waiting.append(held[key])
    return found
