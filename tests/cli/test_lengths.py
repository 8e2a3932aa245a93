"""Lengths with a unit in `--set` and in options."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanloom import UsageError
from scanloom.pipeline.config import Config
from scanloom.stages.params.lengths import parse_length

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize(
    ("text", "metres"),
    [("5mm", 0.005), ("2 cm", 0.02), ("0.5m", 0.5), ("1e-3 m", 0.001), ("0.005", 0.005), (" 7 mm ", 0.007)],
)
def test_units_are_converted(text: str, metres: float) -> None:
    assert parse_length(text) == metres


@pytest.mark.parametrize("text", ["", "mm", "5 miles", "5mmm", "five", "5 m m"])
def test_malformed_lengths_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="could not convert"):
        parse_length(text)


def test_set_converts_units_of_lengths() -> None:
    assert Config().set(["simplify.max_shape=5mm"]) == Config().set(["simplify.max_shape=0.005"])
    assert Config().set(["simplify.max_shape=none"]).simplify.max_shape is None
    # Only lengths have units.
    with pytest.raises(UsageError):
        Config().set(["simplify.max_color=5mm"])
    with pytest.raises(UsageError):
        Config().set(["simplify.max_shape=5 miles"])


def test_options_convert_units_of_lengths(scanloom: Callable[..., Any], tmp_path: Path) -> None:
    source = ROOT / "samples" / "truth.ply"
    found = scanloom("simplify", source, tmp_path / "light.ply", "--max-shape", "5mm", "--json")
    assert found.exit_code == 0
    assert json.loads(found.stdout)["details"]["max_shape_m"] == 0.005
    wrong = scanloom("simplify", source, tmp_path / "none.ply", "--max-shape", "5 miles")
    assert wrong.exit_code == 2
    assert "5 miles" in wrong.stderr
