"""Chunks that decompress to more than their stated size, for each compression."""

import bz2
import sys
import tracemalloc

import lz4.frame
import pytest

from scanloom.stages.scans.recordings import chunked

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

ZEROS = bytes(1 << 26)


@pytest.mark.parametrize(
    ("compression", "pack"), [("bz2", bz2.compress), ("lz4", lz4.frame.compress), ("zstd", zstd.compress)]
)
def test_no_more_is_unpacked_than_a_chunk_states(tmp_path, compression, pack):
    packed = pack(ZEROS)
    file = tmp_path / "take"
    file.write_bytes(packed)
    chunk = chunked.Chunk(0, len(packed), compression, 1000)
    tracemalloc.start()
    with chunked.open_span(file) as span:
        content = chunked._decompress_chunk(span, chunk, file, None)
        assert content.read(0, 1000) == bytes(1000)
        with pytest.raises(EOFError):
            content.read(0, 1001)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 16 << 20
