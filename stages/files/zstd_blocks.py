"""Zstandard decompression with a size limit."""

from __future__ import annotations

import sys

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"


def decompress_zstd(data: bytes, max_bytes: int) -> bytes:
    """Decompress a zstd block, up to the first `max_bytes` bytes.

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
        return bytes(zstd.ZstdDecompressor().decompress(data, max_bytes))
    except zstd.ZstdError as error:
        raise ValueError("damaged") from error
