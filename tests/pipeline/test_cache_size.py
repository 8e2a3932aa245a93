"""The limit on the size of a cache: its notation, and its effect in runs."""

from __future__ import annotations

import pytest

from scanloom.pipeline.cache.cache_size import CacheParams, parse_size
from scanloom.pipeline.config import Config
from scanloom.stages.diagnostics.errors import UsageError


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("20 GB", 20_000_000_000),
        ("20GB", 20_000_000_000),
        ("1.5 tb", 1_500_000_000_000),
        ("500 MB", 500_000_000),
        ("500", 500_000_000),
        ("0", 0),
        ("2 kB", 2000),
    ],
)
def test_sizes_are_parsed_in_common_notations(text: str, size: int) -> None:
    assert parse_size(text, "max_size") == size


@pytest.mark.parametrize(
    "text", ["", "much", "-1 GB", "1e9", "20 GiB", "nan", "9" * 5000, "1 GB 2 MB", "2000000000"]
)
def test_invalid_sizes_are_one_sentence(text: str) -> None:
    with pytest.raises(UsageError, match=r"^max_size is .*; it must be a size such as 500 MB"):
        parse_size(text, "max_size")


def test_the_configuration_has_a_maximum_cache_size() -> None:
    assert Config().cache.max_bytes is None
    assert Config().set(["cache.max_size=20 GB"]).cache.max_bytes == 20_000_000_000
    assert Config.loads('[cache]\nmax_size = "1 TB"').cache == CacheParams(max_size="1 TB")
    with pytest.raises(UsageError, match=r"cache\.max_size is 'much'"):
        Config().set(["cache.max_size=much"])
