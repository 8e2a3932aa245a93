"""Apple's LZFSE compression, with the decompressed size checked first.

The block headers state the decompressed size. The sizes are summed before decompression, so that a few bytes
cannot expand to gigabytes.
"""

from __future__ import annotations

import struct

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DAMAGED
from scanloom.stages.files.memory_check import check_memory_available

# Bytes. Encoders fill blocks of tens of kilobytes; a file of thousands of tiny blocks is an attack.
_MIN_BLOCK_BYTES = 1 << 12
_END_MARKER = b"bvx$"


def decompress_lzfse(data: bytes, size: int, source: str) -> bytes:
    """Decompress LZFSE data to exactly `size` bytes.

    Parameters
    ----------
    source : file name for messages.

    Raises
    ------
    InputError
        If the data is damaged or decompresses to a different size.
    """
    import lzfse

    promised = sum_block_sizes(data)
    if promised is None:
        raise InputError(FILE_DAMAGED, "the LZFSE data is damaged or cut short.", source)
    if promised != size:
        raise InputError(
            FILE_DAMAGED,
            "it decompresses to {promised} bytes, but {size} are expected.",
            source,
            promised=promised,
            size=size,
        )
    try:
        raw = bytes(lzfse.decompress(data))
    except (lzfse.error, ValueError, MemoryError) as error:
        check_memory_available(2 * size)
        raise InputError(FILE_DAMAGED, "the LZFSE data is damaged or cut short.", source) from error
    if len(raw) != size:
        raise InputError(FILE_DAMAGED, "the LZFSE data is damaged or cut short.", source)
    return raw


def sum_block_sizes(data: bytes) -> int | None:
    """Sum the decompressed sizes in the block headers, bytes; None if damaged."""
    at = total = blocks = 0
    try:
        while data[at : at + 4] != _END_MARKER:
            raw, length = _parse_block(data, at)
            total += raw
            blocks += 1
            at += length
            if length <= 0 or at > len(data):
                return None
    except (struct.error, ValueError):
        return None
    return total if blocks <= total // _MIN_BLOCK_BYTES + 2 else None


def _parse_block(data: bytes, at: int) -> tuple[int, int]:
    """Parse the block header at an offset.

    Returns the decompressed size and the length of the block in the file, both in bytes.

    Raises
    ------
    ValueError
        For an unknown block type.
    """
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
