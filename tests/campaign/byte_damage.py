"""Damage to files as rows of bytes: flipped, cut, doubled, moved, and numbers that lie."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

# Counts, sizes and coordinates that a header or a row may claim.
_WHOLE = (0, 1, -1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1)
_REAL = (0.0, -1.0, float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 1e-300, 1e38, 1e20)


def flipped(data: bytes, draw: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 64))):
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def cut_short(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data))]


def doubled(data: bytes, draw: random.Random) -> bytes:
    a, b = _span(data, draw)
    return data[:b] + data[a:b] * draw.choice((1, 1, 3, 50)) + data[b:]


def removed(data: bytes, draw: random.Random) -> bytes:
    a, b = _span(data, draw)
    return data[:a] + data[b:]


def filled(data: bytes, draw: random.Random) -> bytes:
    a, b = _span(data, draw)
    return data[:a] + bytes([draw.choice((0, 0xFF, draw.randrange(256)))]) * (b - a) + data[b:]


def appended(data: bytes, draw: random.Random) -> bytes:
    return data + draw.choice((bytes(100), b"\xff" * 100, data, draw.randbytes(50)))


def whole_number(data: bytes, draw: random.Random) -> bytes:
    """Replace some bytes, near the start more often, by a whole number of two, four or eight bytes."""
    kind = draw.choice("HIQ")
    size = struct.calcsize(kind)
    value = draw.choice(_WHOLE) & (256**size - 1)
    return _placed(data, struct.pack(draw.choice("<>") + kind, value), draw)


def real_number(data: bytes, draw: random.Random) -> bytes:
    kind = draw.choice("fd")
    value = draw.choice(_REAL)
    if kind == "f" and 1e38 < abs(value) < float("inf"):
        value = 3e38
    return _placed(data, struct.pack("<" + kind, value), draw)


_ALL: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    flipped,
    cut_short,
    doubled,
    removed,
    filled,
    appended,
    whole_number,
    whole_number,
    real_number,
)


def damaged_bytes(data: bytes, draw: random.Random) -> bytes:
    """Return a file's content with one damage of any of these kinds."""
    return draw.choice(_ALL)(data or b"\0", draw)


def _span(data: bytes, draw: random.Random) -> tuple[int, int]:
    a = draw.randrange(len(data))
    return a, min(len(data), a + draw.choice((1, 2, 4, 12, 64, 1000)))


def _placed(data: bytes, value: bytes, draw: random.Random) -> bytes:
    # Headers lie at the start, and many formats keep their lists of contents at the end.
    reach = draw.choice((64, 512, len(data)))
    at = draw.randrange(min(len(data), reach))
    if draw.random() < 0.2:
        at = len(data) - 1 - at
    return data[:at] + value + data[at + len(value) :]
