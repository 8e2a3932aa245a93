"""The table of mutants matches the sources: each text occurs once, and each Rust test exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def list_mutant_names() -> list[str]:
    table = (Path(__file__).with_name("mutant_table.py")).read_text(encoding="utf-8")
    return re.findall(r'^    "([\w-]+)": Mutant\($', table, re.MULTILINE)


@pytest.mark.parametrize("name", list_mutant_names())
def test_every_mutant_finds_its_text_and_its_test(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    monkeypatch.syspath_prepend(str(ROOT))
    from tests.campaign.mutant_table import MUTANTS
    from tests.campaign.mutants import mutate

    mutant = MUTANTS[name]
    source = (ROOT / mutant.file).read_text(encoding="utf-8")
    assert mutate(mutant, source) != source
    rust = [
        path.read_text(encoding="utf-8")
        for path in (ROOT / "kernels").rglob("*.rs")
        if "target" not in path.parts
    ]
    assert sum(len(re.findall(rf"#\[test\]\s*fn {mutant.test}\(", text)) for text in rust) == 1
