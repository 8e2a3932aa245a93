"""Each stage has a page that lists its metrics, files and parameters."""

import re
from pathlib import Path

import pytest

from scanloom.pipeline.graph import STAGES

ROOT = Path(__file__).resolve().parents[2]
PAGES = ROOT / "docs" / "stages"
# Quoted names, and names before a colon or an equals sign, in the sources.
NAME = re.compile(r"[\"'](\w+)[\"']|\b(\w+) *[:=]")
NAMES = {
    name
    for folder in ("stages", "pipeline")
    for path in (ROOT / folder).rglob("*.py")
    for found in NAME.findall(path.read_text())
    for name in found
}


def test_every_stage_has_a_page_linked_from_the_overview():
    overview = (ROOT / "docs" / "stages.md").read_text()
    names = {stage.name for stage in STAGES}

    assert {path.stem for path in PAGES.glob("*.md")} == names
    assert names <= set(re.findall(r"\]\(stages/(\w+)\.md\)", overview))


@pytest.mark.parametrize("stage", STAGES, ids=lambda stage: stage.name)
def test_a_page_lists_metrics_files_and_parameters_of_its_stage(stage):
    text = (PAGES / f"{stage.name}.md").read_text()

    assert set(stage.sections) == set(re.findall(r"^```\{made\} parameters (\w+)$", text, flags=re.MULTILINE))
    for result in stage.result_names:
        assert result.rstrip("/") in text
    (metrics,) = re.findall(
        r"^## Metrics\n(.*?)^(?:Rules|More|Warnings)", text, flags=re.MULTILINE | re.DOTALL
    )
    named = set(re.findall(r"`(\w+)`", metrics))
    assert named
    assert named - NAMES == set()
