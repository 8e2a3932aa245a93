"""Options come from the parameter class alone: name, type, range, unit, default, text."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Any

import pytest
import typer
from typer.testing import CliRunner

from scanloom.cli.options import build, given, with_options
from scanloom.cli.output import Output
from scanloom.cli.rendering import render
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check, param


@dataclass(frozen=True, kw_only=True)
class CableParams:
    """Parameters of `cable` stitches."""

    twist: float = param(0.5, "Turns of a cable.", unit="turns", low=0)
    is_left: bool = param(False, "Twist to the left.")

    def __post_init__(self) -> None:
        check(self)


@dataclass(frozen=True, kw_only=True)
class KnittingParams:
    """How to knit."""

    stitch_width: float = param(0.25, "Width of a stitch [flat].", unit="m", low=0, low_open=True)
    rows: int | None = param(None, "Rows; the wool decides.", low=1, high=99)
    purl: bool = param(True, "Purl every second row.")
    corner: tuple[float, float] | None = param(None, "Where to begin.", unit="m")
    yarn: str = param("wool", "What to knit with.", choices=("wool", "silk"))
    cable: CableParams = field(default=CableParams())

    def __post_init__(self) -> None:
        check(self)


@pytest.fixture
def knit() -> Any:
    calls: list[tuple[str, KnittingParams, Output]] = []

    def command(target: str, params: KnittingParams, out: Output) -> None:
        calls.append((target, params, out))

    app = typer.Typer(rich_markup_mode="rich")
    app.command()(with_options(command))

    def run(*words: str) -> Any:
        calls.clear()
        result = CliRunner().invoke(app, list(words), env={"COLUMNS": "200", "NO_COLOR": "1"})
        return result, (calls[0] if calls else None)

    return run


def test_options_not_given_keep_the_declared_defaults(knit: Any) -> None:
    result, (target, params, out) = knit("sock")
    assert result.exit_code == 0
    assert target == "sock"
    assert params == KnittingParams()
    assert not out.quiet


def test_options_given_reach_their_fields(knit: Any) -> None:
    words = ("--stitch-width", "0.5", "--rows", "3", "--no-purl", "--yarn", "silk", "--json")
    _, (target, params, out) = knit("--corner", "-1", "2.5", "sock", *words)
    assert target == "sock"
    assert params == KnittingParams(stitch_width=0.5, rows=3, purl=False, yarn="silk", corner=(-1.0, 2.5))
    assert out.as_json


def test_options_of_nested_parameters_go_by_their_own_names(knit: Any) -> None:
    _, (_, params, _) = knit("sock", "--twist", "2", "--is-left")
    assert params == KnittingParams(cable=CableParams(twist=2.0, is_left=True))
    assert given(KnittingParams, {"twist": 3.0, "rows": 2}) == {"rows": 2, "cable": {"twist": 3.0}}
    text = re.sub(r"\s+", " ", knit("--help")[0].output.replace("│", " "))
    assert "Parameters of cable stitches" in text
    assert "Turns of a cable. (turns; at least 0; default: 0.5)" in text


def test_two_options_of_one_name_are_refused() -> None:
    @dataclass(frozen=True)
    class Twice:
        twist: float = param(1.0, "Turns.")
        cable: CableParams = field(default=CableParams())

    def command(params: Twice) -> None:
        del params

    command.__annotations__ = {"params": Twice}
    with pytest.raises(TypeError, match="two parameters twist"):
        with_options(command)


def test_help_shows_text_unit_range_and_default(knit: Any) -> None:
    result, _ = knit("--help")
    text = re.sub(r"\s+", " ", result.output.replace("│", " "))
    assert "Width of a stitch [flat]. (m; above 0; default: 0.25)" in text
    assert "Rows; the wool decides. (1 to 99; no fixed default)" in text
    assert "Purl every second row. (default: on)" in text
    assert "wool|silk" in text
    assert re.search(r"--corner <float> <float> Where to begin\. \(m; no fixed default\)", text)
    assert "Knitting parameters" in text


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("stitch_width", -1.0, "--stitch-width is -1 m; it must be more than 0 m."),
        ("rows", 100, "--rows is 100; it must be at most 99."),
        ("yarn", "wire", "--yarn is 'wire'; it must be one of wool, silk."),
    ],
)
def test_a_value_out_of_range_is_named_as_it_was_typed(field: str, value: object, sentence: str) -> None:
    values = dict.fromkeys(("stitch_width", "rows", "purl", "yarn")) | {field: value}
    with pytest.raises(UsageError) as caught:
        build(KnittingParams, values)
    assert render(caught.value.diagnostic) == sentence


def test_a_word_where_a_number_belongs_is_wrong_usage(knit: Any) -> None:
    for words in (("--rows", "many"), ("--corner", "1", "x"), ("--corner", "1")):
        result, call = knit("sock", *words)
        assert result.exit_code == 2
        assert call is None
