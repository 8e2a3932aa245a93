"""Option `--quality`: printed values, effect on a run, and conflicts with a configuration file."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from scanloom.pipeline.config import Config
from scanloom.pipeline.quality_presets import QUALITIES

Run = Callable[..., Any]


def test_config_prints_the_values_of_a_quality(scanloom: Run) -> None:
    for quality, values in QUALITIES.items():
        text = scanloom("config", "--quality", quality).stdout
        comment, _, rest = text.partition("quality = ")
        assert rest.startswith(f'"{quality}"\n')
        for section, names in values.items():
            assert all(f"{section}.{name}" in comment.replace("\n# ", " ") for name in names)
        assert Config.loads(text) == Config.from_quality(quality)


def test_an_unknown_quality_is_wrong_usage(scanloom: Run, tiny_scan: Path, tmp_path: Path) -> None:
    ran = scanloom("run", tiny_scan, "-o", tmp_path / "out", "--quality", "bests")
    assert (ran.exit_code, ran.stderr) == (
        2,
        "scanloom: --quality is 'bests'; it must be one of draft, standard, best.\n",
    )


def test_values_of_a_file_that_override_the_quality_are_reported(scanloom: Run, tmp_path: Path) -> None:
    file = tmp_path / "f.toml"
    file.write_text(scanloom("config", "--all").stdout)
    ran = scanloom("config", "--check", file, "--quality", "draft")
    [line] = ran.stderr.splitlines()
    assert line.startswith(f"warning: {file}: the file overrides --quality draft in voxel_factor of fuse, ")
    file.write_text('quality = "best"\n[simplify]\nratio = 0.5\n')
    ran = scanloom("config", "--check", file, "--quality", "draft", "--json")
    assert ran.stderr == ""
    assert ran.json["simplify"]["ratio"] == 0.5
    assert ran.json["fuse"]["voxel_factor"] == 2


@pytest.mark.slow
def test_draft_is_coarser_and_standard_equals_the_default(
    scanloom: Run, tiny_scan: Path, tmp_path: Path
) -> None:
    words = ("run", tiny_scan, "-o", tmp_path / "out", "--set", "report.page=false", "--json")
    few = ("--set", "report.viewpoints=1", "--set", "report.width=64", "--set", "compare.samples=1000")
    usual = scanloom(*words, *few).json
    again = scanloom(*words, *few, "--quality", "standard").json
    assert all(stage["cached"] for stage in again["stages"].values())
    draft = scanloom(*words, "--quality", "draft").json
    assert [name for name, stage in draft["stages"].items() if stage["cached"]] == ["adjust"]
    fused = [one["stages"]["fuse"]["metrics"]["triangles"] for one in (usual, draft)]
    assert fused[1] < fused[0] / 3
    assert draft["mesh"]["triangles"] < usual["mesh"]["triangles"]
    sizes = [one["stages"]["fuse"]["metrics"]["voxel_size_m"] for one in (usual, draft)]
    assert sizes[1] == pytest.approx(2 * sizes[0], rel=0.05)
    assert draft["pictures"] == []
    set_here = scanloom(*words, *few, "--quality", "draft", "--set", "fuse.voxel_factor=1").json
    assert set_here["stages"]["fuse"]["cached"]


WORDS = [("config",), ("run", "samples", "-o", "out"), ("batch", "samples", "-o", "out")]


@pytest.mark.parametrize("words", WORDS)
def test_an_empty_quality_is_refused(scanloom: Run, words: tuple[str, ...]) -> None:
    ran = scanloom(*words, "--quality", "")
    assert ran.exit_code == 2
    assert ran.stderr == "scanloom: --quality is ''; it must be one of draft, standard, best.\n"
