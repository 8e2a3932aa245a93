"""Options follow the parameter class: name, type, range, unit, default and text; `--set` sets the rest."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import Annotated, Any

import pytest
import typer
from typer.testing import CliRunner

from scanloom.cli.help import HelpCommand
from scanloom.cli.options import SET_ONLY, Changes, ParameterGroup, build, describe_set, with_options
from scanloom.cli.output import Output
from scanloom.cli.rendering import command_line, render
from scanloom.stages.diagnostics.codes import MACHINE_BUG
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param


@dataclass(frozen=True, kw_only=True)
class CableParams:
    """Parameters of `cable` stitches."""

    twist: float = param(0.5, "Turns of a cable.", unit="turns", low=0, common=True)
    is_left: bool = param(False, "Twist to the left.")

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class KnittingParams:
    """Parameters of knitting."""

    stitch_width: float = param(0.25, "Width of a stitch.", unit="m", low=0, low_open=True, common=True)
    rows: int | None = param(None, "Rows; the wool decides.", low=1, high=99, common=True)
    purl: bool = param(True, "Purl every second row.", common=True)
    corner: tuple[float, float] | None = param(None, "Where to begin.", unit="m", common=True)
    yarn: str = param("wool", "What to knit with.", choices=("wool", "silk"), common=True)
    gauge: float = param(1.0, "Stitches per row.", low=0)
    cable: CableParams = field(default=CableParams())

    def __post_init__(self) -> None:
        check_parameters(self)


@dataclass(frozen=True, kw_only=True)
class WashParams:
    """Parameters of washing."""

    warmth: float = param(30.0, "Temperature.", unit="°C", low=0, common=True)

    def __post_init__(self) -> None:
        check_parameters(self)


KNITTING = ParameterGroup("knitting", KnittingParams)


@pytest.fixture
def knit() -> Any:
    calls: list[tuple[Any, ...]] = []

    def command(
        target: str,
        knitting: KnittingParams,
        wash: Annotated[Changes[WashParams], SET_ONLY],
        out: Output,
    ) -> None:
        calls.append((target, knitting, out, wash))

    command.__annotations__ |= {
        "knitting": KnittingParams,
        "wash": Annotated[Changes[WashParams], SET_ONLY],
        "out": Output,
        "target": str,
    }
    app = typer.Typer(rich_markup_mode=None)
    help_class = type("Help", (HelpCommand,), {"hint": describe_set(command)})
    app.command(cls=help_class)(with_options(command))

    def run(*words: str) -> Any:
        calls.clear()
        result = CliRunner().invoke(app, list(words), env={"COLUMNS": "100"})
        return result, (calls[0] if calls else None)

    with command_line():
        yield run


def test_parameters_without_option_keep_the_declared_defaults(knit: Any) -> None:
    result, (target, params, out, wash) = knit("sock")
    assert result.exit_code == 0
    assert target == "sock"
    assert params == KnittingParams()
    assert wash == {}
    assert not out.quiet


def test_options_reach_their_parameters(knit: Any) -> None:
    words = ("--stitch-width", "0.5", "--rows", "3", "--no-purl", "--yarn", "silk", "--json", "--twist", "2")
    _, (target, params, out, _) = knit("--corner", "-1", "2.5", "sock", *words)
    assert target == "sock"
    assert params == KnittingParams(
        stitch_width=0.5, rows=3, purl=False, yarn="silk", corner=(-1.0, 2.5), cable=CableParams(twist=2.0)
    )
    assert out.as_json


def test_set_reaches_every_parameter(knit: Any) -> None:
    words = ("knitting.gauge=2", "knitting.cable.is_left=true", "knitting.rows=7", "wash.warmth=40")
    _, (_, params, _, wash) = knit(
        "sock", "--twist", "3", *(part for one in words for part in ("--set", one))
    )
    assert params == KnittingParams(gauge=2.0, rows=7, cable=CableParams(is_left=True, twist=3.0))
    assert wash == {"warmth": 40.0}


def test_the_last_of_two_assignments_wins(knit: Any) -> None:
    _, (_, params, _, _) = knit("sock", "--set", "knitting.gauge=2", "--set", "knitting.gauge=3")
    assert params.gauge == 3


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--set", "knitting.guage=1"), "did you mean knitting.gauge?"),
        (("--set", "knitting.warmth=1"), "did you mean wash.warmth?"),
        (("--set", "kniting.gauge=1"), "there is no section 'kniting'; did you mean knitting?"),
        (("--set", "gauge=1"), "write section.parameter=value"),
        (("--set", "knitting.gauge=-1"), "--set knitting.gauge is -1; it must be at least 0."),
        (("--set", "knitting.gauge=many"), "--set knitting.gauge is 'many'; it must be a number."),
        # A range error of an option names the option, one of --set names the parameter.
        (("--set", "knitting.rows=100"), "--set knitting.rows is 100; it must be at most 99."),
        (("--rows", "100"), "--rows is 100; it must be at most 99."),
        (("--twist", "-1"), "--twist is -1 turns; it must be at least 0 turns."),
        (("--set", "wash.warmth=-1"), "--set wash.warmth is -1 °C"),
        (
            ("--rows", "3", "--set", "knitting.rows=4"),
            "both --rows and --set knitting.rows are given; omit one of them.",
        ),
    ],
)
def test_mistakes_are_quoted_as_they_were_typed(knit: Any, words: tuple[str, ...], sentence: str) -> None:
    result, call = knit("sock", *words)
    assert call is None
    assert isinstance(result.exception, UsageError)
    assert sentence in render(result.exception.diagnostic)


def test_advice_names_options_or_set(knit: Any) -> None:
    knit("sock")
    advice = MACHINE_BUG.warning(
        "odd", remedy="set knitting.gauge=2, try knitting.purl=false or knitting.twist; see knitting.rows.txt"
    )
    assert render(advice) == (
        "odd; give --set knitting.gauge=2, try --no-purl or knitting.twist; see knitting.rows.txt"
    )
    nested = MACHINE_BUG.warning("odd", remedy="Set knitting.cable.twist=2 (see also fuse.voxel_size).")
    assert render(nested) == "odd; Give --twist=2 (see also --set fuse.voxel_size)."


def test_two_options_with_the_same_name_are_refused() -> None:
    @dataclass(frozen=True)
    class Twice:
        twist: float = param(1.0, "Turns.", common=True)

    def command(a: Twice, b: Twice) -> None:
        del a, b

    command.__annotations__ = {"a": Twice, "b": Twice}
    with pytest.raises(TypeError, match="two options twist"):
        with_options(command)


def test_help_shows_text_unit_range_and_default(knit: Any) -> None:
    result, _ = knit("--help")
    text = re.sub(r"\s+", " ", result.output)
    assert "Width of a stitch. [m, above 0, default: 0.25]" in text
    assert "Rows; the wool decides. [1 to 99]" in text
    assert "--purl / --no-purl Purl every second row. [default: on]" in text
    assert "--yarn wool|silk What to knit with. [default: wool]" in text
    assert "--corner X X Where to begin. [m]" in text
    assert "--twist NUMBER Turns of a cable. [turns, at least 0, default: 0.5]" in text
    assert "--set SECTION.KEY=VALUE Set a parameter of knitting or wash" in text
    assert not re.search("--gauge|--is-left|--warmth", text)
    assert text.endswith("Parameters for --set: scanloom config knitting wash ")
    assert max(map(len, result.output.splitlines())) <= 100


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("stitch_width", -1.0, "knitting.stitch_width is -1 m; it must be more than 0 m."),
        ("rows", 100, "knitting.rows is 100; it must be at most 99."),
        ("yarn", "wire", "knitting.yarn is 'wire'; it must be one of wool, silk."),
    ],
)
def test_a_value_out_of_range_is_named_by_its_key(field: str, value: object, sentence: str) -> None:
    with pytest.raises(UsageError) as caught:
        build(KNITTING, {field: value})
    assert str(caught.value) == sentence


def test_changes_contain_only_given_parameters() -> None:
    group = ParameterGroup("knitting", KnittingParams, is_changes=True)
    assert build(group, {"rows": 2, "twist": 3.0}) == {"rows": 2, "cable": {"twist": 3.0}}


def test_text_in_place_of_a_number_is_wrong_usage(knit: Any) -> None:
    for words in (("--rows", "many"), ("--corner", "1", "x"), ("--corner", "1")):
        result, call = knit("sock", *words)
        assert result.exit_code == 2
        assert call is None
