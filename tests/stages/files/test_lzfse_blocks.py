import contextlib

import lzfse
import numpy as np
import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.lzfse_blocks import decompress_lzfse, sum_block_sizes

RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    "raw",
    [
        b"a",
        bytes(12),
        bytes(1 << 20),
        RNG.bytes(40_000),
        RNG.uniform(0.5, 4, 49_152).astype(np.float32).tobytes(),
        b"abc" * 500,
    ],
)
def test_compression_is_inverted(raw):
    data = lzfse.compress(raw)
    assert sum_block_sizes(data) == len(raw)
    assert decompress_lzfse(data, len(raw), "a") == raw


def test_an_unexpected_size_is_refused_before_decompression(monkeypatch):
    data = lzfse.compress(bytes(1 << 20))
    monkeypatch.setattr(lzfse, "decompress", lambda _: pytest.fail("it was decompressed"))
    with pytest.raises(InputError, match="a: it decompresses to 1048576 bytes, but 100 are expected"):
        decompress_lzfse(data, 100, "a")


def test_thousands_of_tiny_blocks_are_refused():
    block = b"bvx-" + (1).to_bytes(4, "little") + b"x"
    assert sum_block_sizes(block * 2 + b"bvx$") == 2
    assert sum_block_sizes(block * 5000 + b"bvx$") is None


def test_truncation_is_an_error_and_damage_gives_an_error_or_other_bytes():
    raw = RNG.uniform(0.5, 4, 2000).astype(np.float32).tobytes()
    data = lzfse.compress(raw)
    for length in range(0, len(data), 101):
        with pytest.raises(InputError, match="damaged or cut short"):
            decompress_lzfse(data[:length], len(raw), "a")
    for _ in range(300):
        broken = bytearray(data)
        for at in RNG.integers(0, len(data), 4):
            broken[at] = RNG.integers(256)
        with contextlib.suppress(InputError):
            assert len(decompress_lzfse(bytes(broken), len(raw), "a")) == len(raw)
