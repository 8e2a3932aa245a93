"""Tables and page of a batch: content, and protection of other files."""

from __future__ import annotations

import csv
import io
import json
import re
from pathlib import Path

import pytest

from scanloom.pipeline.batch import summary_files
from scanloom.pipeline.batch.job_records import DONE, FAILED, RUNNING, UNUSABLE, WAITING, JobRecord
from scanloom.pipeline.batch.summary import COLUMNS, BatchSummary, format_csv, format_parquet
from scanloom.pipeline.batch.summary_files import check_outputs_replaceable, remove_outputs, write_outputs
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import InputError

FIGURES = {
    "layout": "tum",
    "frames": 24,
    "triangles": 1000,
    "metric": True,
    "voxel_size_m": 0.006,
    "manifold": False,
}
ODD = (MACHINE_BUG.warning("odd"), MACHINE_BUG.warning("odder"))
RECORDS = (
    JobRecord(0, "hall", DONE, "", 12.5, diagnostics=ODD, metrics=FIGURES),
    JobRecord(1, 'a, "b" </script><b>', FAILED, "fuse failed: the disk is full;\nfree some.", 1.0),
    JobRecord(2, "späße", UNUSABLE, "x: no", 0.1),
)


@pytest.fixture
def summary(tmp_path: Path) -> BatchSummary:
    return BatchSummary(tmp_path, RECORDS, ("/s/hall", "/s/b", "/s/c"))


def test_counts_and_states_of_a_summary(summary: BatchSummary):
    assert summary.counts == {DONE: 1, FAILED: 1, UNUSABLE: 1}
    assert summary.is_finished
    assert not summary.is_unusable
    assert [one.name for one in summary.not_done] == [RECORDS[1].name, RECORDS[2].name]
    open_ones = BatchSummary(Path(), (JobRecord(0, "a", WAITING), JobRecord(1, "b", RUNNING)), ("", ""))
    assert not open_ones.is_finished
    assert open_ones.not_done == []
    assert BatchSummary(Path(), RECORDS[2:], ("",)).is_unusable


def test_csv_has_every_column_and_every_scan(summary: BatchSummary):
    rows = list(csv.DictReader(io.StringIO(format_csv(summary.make_rows()).decode())))
    assert list(rows[0]) == list(COLUMNS)
    assert [row["scan"] for row in rows] == [one.name for one in RECORDS]
    assert rows[0]["triangles"] == "1000"
    assert rows[0]["manifold"] == "false"
    assert rows[0]["warnings"] == "2"
    assert rows[1]["reason"] == RECORDS[1].reason
    assert rows[1]["triangles"] == ""


def test_parquet_has_the_same_content_with_types(summary: BatchSummary):
    parquet = pytest.importorskip("pyarrow.parquet")
    data = format_parquet(summary.make_rows())
    assert data is not None
    table = parquet.read_table(io.BytesIO(data))
    assert table.column_names == list(COLUMNS)
    assert table["triangles"].to_pylist() == [1000, None, None]
    assert table["voxel_size_m"].to_pylist() == [0.006, None, None]
    assert str(table.schema.field("metric").type) == "bool"
    # Without rows, the columns have the same types.
    assert parquet.read_table(io.BytesIO(format_parquet([]) or b"")).schema == table.schema


def test_the_page_contains_all_rows_and_escapes_them(summary: BatchSummary):
    write_outputs(summary, "many")
    page = (summary.out / "index.html").read_text()
    assert page.count("</script>") == 2
    content = json.loads(re.findall(r'id="content">(.*?)</script>', page)[0])
    assert [row["scan"] for row in content["rows"]] == [one.name for one in RECORDS]
    assert content["rows"][0]["warnings"] == ["odd", "odder"]
    assert not re.search(r"https?://", page)


def test_without_pyarrow_an_old_parquet_file_is_removed(
    summary: BatchSummary, monkeypatch: pytest.MonkeyPatch
):
    (summary.out / "batch.parquet").write_bytes(b"PAR1 of before")
    monkeypatch.setattr(summary_files, "format_parquet", lambda _: None)
    assert [path.name for path in write_outputs(summary, "many")] == ["index.html", "batch.csv"]
    assert not (summary.out / "batch.parquet").exists()


def test_files_of_a_batch_are_replaced_and_removed(summary: BatchSummary):
    write_outputs(summary, "many")
    check_outputs_replaceable(summary.out)
    (summary.out / "notes.txt").write_text("mine")
    remove_outputs(summary.out)
    assert [path.name for path in summary.out.iterdir()] == ["notes.txt"]
    (summary.out / "index.html").write_text("mine, too")
    remove_outputs(summary.out)
    assert (summary.out / "index.html").exists()


@pytest.mark.parametrize("name", ["index.html", "batch.csv", "batch.parquet"])
def test_other_files_are_not_replaced(tmp_path: Path, name: str):
    (tmp_path / name).write_text("mine")
    with pytest.raises(InputError, match=f"{name}: this file was not written by a batch"):
        check_outputs_replaceable(tmp_path)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to(tmp_path / "elsewhere")
    with pytest.raises(InputError, match="this file was not written by a batch"):
        check_outputs_replaceable(tmp_path)


@pytest.mark.parametrize(
    "name", ["=cmd|' /C calc'!A0", "+1+1", "-2+3", "@SUM(A1)", "\t=1", "\r=1", " =1", "\n=1", "＝1", "\x1b=1"]
)
def test_no_csv_cell_is_a_formula(tmp_path: Path, name: str):
    record = JobRecord(0, name, FAILED, name, -1.5, diagnostics=(), metrics={"layout": name})
    table = format_csv(BatchSummary(tmp_path, (record,), (name,)).make_rows()).decode()
    (row,) = csv.DictReader(io.StringIO(table, newline=""))
    for column in ("scan", "reason", "out", "folder", "layout"):
        assert row[column].startswith(("'", "\ufffd"))
        assert row[column].endswith(name.lstrip("\r\x1b"))
    assert row["seconds"] == "-1.5"
    assert not re.search("[\x00-\x08\x0b-\x1f\x7f-\x9f]", table)
