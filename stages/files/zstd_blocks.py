"""Zstandard decompression with a size limit."""

from __future__ import annotations

import sys

MAGIC = b"\x28\xb5\x2f\xfd"


def unpacked(data: bytes, most: int) -> bytes:
    """Decompress a zstd block, up to the first `most` bytes.

    Raises
    ------
    ValueError
        If the block is damaged.
    """
    if sys.version_info >= (3, 14):
        from compression import zstd
    else:
        from backports import zstd

    try:
        return bytes(zstd.ZstdDecompressor().decompress(data, most))
    except zstd.ZstdError as error:
        raise ValueError("damaged") from error
