"""Apple's LZFSE: data whose size is known beforehand, so that a few bytes cannot become gigabytes.

What a file promises is summed up from the heads of its blocks before anything is decompressed.
"""

from __future__ import annotations

import struct

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DAMAGED
from scanloom.stages.files.room import require_room

# An encoder fills blocks of tens of kilobytes; thousands of small ones are made to swell.
_SMALLEST_BLOCK = 1 << 12
_END = b"bvx$"


def decompress(data: bytes, size: int, source: str) -> bytes:
    """Return the `size` bytes that LZFSE data stands for.

    Raises
    ------
    InputError
        If the data is damaged or stands for another number of bytes; `source` is named.
    """
    import lzfse

    promised = raw_size(data)
    if promised is None:
        raise InputError(FILE_DAMAGED, "the LZFSE data is damaged or cut short.", source)
    if promised != size:
        raise InputError(
            FILE_DAMAGED,
            "it holds {promised} bytes where {size} are expected.",
            source,
            promised=promised,
            size=size,
        )
    try:
        raw = bytes(lzfse.decompress(data))
    except (lzfse.error, ValueError, MemoryError) as error:
        require_room(2 * size)
        raise InputError(FILE_DAMAGED, "the LZFSE data is damaged or cut short.", source) from error
    if len(raw) != size:
        raise InputError(FILE_DAMAGED, "the LZFSE data is damaged or cut short.", source)
    return raw


def raw_size(data: bytes) -> int | None:
    """Return how many bytes LZFSE data says that it stands for; None where it is damaged."""
    at = total = blocks = 0
    try:
        while data[at : at + 4] != _END:
            raw, length = _block(data, at)
            total += raw
            blocks += 1
            at += length
            if length <= 0 or at > len(data):
                return None
    except (struct.error, ValueError):
        return None
    return total if blocks <= total // _SMALLEST_BLOCK + 2 else None


def _block(data: bytes, at: int) -> tuple[int, int]:
    """Return what a block stands for and how long it is, in bytes; raise ValueError for an unknown one."""
    kind = data[at : at + 4]
    if kind == b"bvx-":
        (raw,) = struct.unpack_from("<I", data, at + 4)
        return raw, 8 + raw
    if kind == b"bvxn":
        raw, payload = struct.unpack_from("<2I", data, at + 4)
        return raw, 12 + payload
    if kind == b"bvx2":
        (raw,) = struct.unpack_from("<I", data, at + 4)
        first, second, third = struct.unpack_from("<3Q", data, at + 8)
        literals, matches = first >> 20 & 0xFFFFF, second >> 40 & 0xFFFFF
        return raw, (third & 0xFFFFFFFF) + literals + matches
    raise ValueError("no LZFSE block begins here")
