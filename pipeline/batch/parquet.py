"""The table of a batch as a Parquet file, by pyarrow (extra `batch`)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.batch.summary import COLUMNS


def parquet_of(rows: Sequence[Mapping[str, Any]]) -> bytes | None:
    """Return rows as a Parquet file; None where pyarrow is not installed."""
    try:
        import pyarrow
        import pyarrow.parquet as parquet
    except ImportError:
        return None
    kinds = {str: pyarrow.string(), int: pyarrow.int64(), float: pyarrow.float64(), bool: pyarrow.bool_()}
    schema = pyarrow.schema([(name, kinds[kind]) for name, kind in COLUMNS.items()])
    columns = {
        name: [None if row[name] is None else kind(row[name]) for row in rows]
        for name, kind in COLUMNS.items()
    }
    sink = pyarrow.BufferOutputStream()
    parquet.write_table(pyarrow.table(columns, schema=schema), sink)
    return bytes(sink.getvalue().to_pybytes())
