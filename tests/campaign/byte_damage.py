"""Damage to files at byte level: flipped, cut, repeated or moved bytes, and false numbers."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

# Counts, sizes and coordinates that a header or a row may state.
_WHOLE = (0, 1, -1, 0x7F, 0xFF, 0x7FFF, 0xFFFF, 2**31 - 1, 2**31, 2**32 - 1, 2**62, 2**63 - 1)
_REAL = (0.0, -1.0, float("nan"), float("inf"), float("-inf"), 1e300, -1e300, 1e-300, 1e38, 1e20)


def flip_bits(data: bytes, draw: random.Random) -> bytes:
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 64))):
        changed[draw.randrange(len(changed))] ^= 1 << draw.randrange(8)
    return bytes(changed)


def truncate(data: bytes, draw: random.Random) -> bytes:
    return data[: draw.randrange(len(data))]


def repeat_span(data: bytes, draw: random.Random) -> bytes:
    a, b = _choose_span(data, draw)
    return data[:b] + data[a:b] * draw.choice((1, 1, 3, 50)) + data[b:]


def remove_span(data: bytes, draw: random.Random) -> bytes:
    a, b = _choose_span(data, draw)
    return data[:a] + data[b:]


def fill_span(data: bytes, draw: random.Random) -> bytes:
    a, b = _choose_span(data, draw)
    return data[:a] + bytes([draw.choice((0, 0xFF, draw.randrange(256)))]) * (b - a) + data[b:]


def append_bytes(data: bytes, draw: random.Random) -> bytes:
    return data + draw.choice((bytes(100), b"\xff" * 100, data, draw.randbytes(50)))


def write_integer(data: bytes, draw: random.Random) -> bytes:
    """Overwrite some bytes, more often near the start, with an integer of two, four or eight bytes."""
    kind = draw.choice("HIQ")
    size = struct.calcsize(kind)
    value = draw.choice(_WHOLE) & (256**size - 1)
    return _overwrite(data, struct.pack(draw.choice("<>") + kind, value), draw)


def write_float(data: bytes, draw: random.Random) -> bytes:
    kind = draw.choice("fd")
    value = draw.choice(_REAL)
    if kind == "f" and 1e38 < abs(value) < float("inf"):
        value = 3e38
    return _overwrite(data, struct.pack("<" + kind, value), draw)


_ALL: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    flip_bits,
    truncate,
    repeat_span,
    remove_span,
    fill_span,
    append_bytes,
    write_integer,
    write_integer,
    write_float,
)


def damage_bytes(data: bytes, draw: random.Random) -> bytes:
    """Apply one random damage to the content of a file."""
    return draw.choice(_ALL)(data or b"\0", draw)


def _choose_span(data: bytes, draw: random.Random) -> tuple[int, int]:
    a = draw.randrange(len(data))
    return a, min(len(data), a + draw.choice((1, 2, 4, 12, 64, 1000)))


def _overwrite(data: bytes, value: bytes, draw: random.Random) -> bytes:
    # Headers are at the start, and many formats have their table of contents at the end.
    reach = draw.choice((64, 512, len(data)))
    at = draw.randrange(min(len(data), reach))
    if draw.random() < 0.2:
        at = len(data) - 1 - at
    return data[:at] + value + data[at + len(value) :]
