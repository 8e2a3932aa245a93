"""A run in a notebook: its stages as a table, and its page."""

from pathlib import Path

import pytest

from scanloom.pipeline.run.engine import StageOutcome
from scanloom.pipeline.run.run import RunResult
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.simplification.codes import SIMPLIFY_COUNT_NOT_REACHED


def make_outcome(stage: str, *, cached: bool, diagnostics: tuple[Diagnostic, ...] = ()) -> StageOutcome:
    made = {"seconds": 2.5}
    return StageOutcome(stage, cached, "", 0.25, {}, {}, made, Path(), (), diagnostics)


@pytest.fixture
def result(tmp_path: Path) -> RunResult:
    told = (SIMPLIFY_COUNT_NOT_REACHED.unmet("no"), SIMPLIFY_COUNT_NOT_REACHED.warning("odd"))
    stages = (make_outcome("fuse", cached=True), make_outcome("<simplify>", cached=False, diagnostics=told))
    report = {"mesh": {"triangles": 1234}}
    return RunResult(tmp_path / "o<u>t", tmp_path, stages, report, diagnostics=told)


def test_repr_is_one_line(result):
    assert (
        repr(result) == f"RunResult({result.out}, 2 stages, 1 cached, 1,234 triangles, 1 requirement not met)"
    )
    early = RunResult(result.out, result.cache, result.stages[:1], {"mesh": None})
    assert repr(early) == f"RunResult({result.out}, 1 stage, 1 cached)"


def test_a_notebook_shows_the_stages(result):
    html = result._repr_html_()
    assert html.count("<tr>") == 3
    assert "2.5 s" in html
    assert "&lt;simplify&gt;" in html
    assert "<simplify>" not in html
    assert "o<u>t" not in html


def test_show_displays_the_page_of_the_run(result, tmp_path):
    with pytest.raises(UsageError, match=r"this run has no page; report\.page=true"):
        result.show()
    page = tmp_path / "report.html"
    page.write_bytes(b"<!doctype html>page")
    shown = RunResult(result.out, result.cache, result.stages, result.report, page).show(height=99)
    assert shown.html == page.read_bytes()
    assert "height:99px" in shown._repr_html_()
