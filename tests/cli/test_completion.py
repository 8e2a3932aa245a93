"""What a shell offers for an unfinished line, and that its completion can be installed."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from scanloom.cli.app import run_command
from scanloom.cli.command_table import COMMANDS
from scanloom.cli.completion import complete_assignment
from scanloom.cli.run_options import config_sections
from scanloom.pipeline.config import Config
from scanloom.pipeline.graph import STAGES
from scanloom.pipeline.quality_presets import QUALITIES
from scanloom.stages.params import describe_own

ROOT = Path(__file__).resolve().parents[2]
Offered = Callable[[str], list[str]]


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Offered:
    """What bash is offered for a line; the word to complete is the last, if there is no space behind."""

    def ask(text: str) -> list[str]:
        monkeypatch.setenv("_SCANLOOM_COMPLETE", "complete_bash")
        monkeypatch.setenv("COMP_WORDS", text)
        monkeypatch.setenv("COMP_CWORD", str(len(text.split()) - (not text.endswith(" "))))
        with pytest.raises(SystemExit) as ended:
            run_command([])
        assert ended.value.code == 0
        captured = capsys.readouterr()
        assert captured.err == ""
        return captured.out.split()

    return ask


def test_commands_and_options(offered: Offered) -> None:
    commands = [name for of_panel in COMMANDS.values() for name in of_panel]
    assert set(offered("scanloom ")) == set(commands)
    assert offered("scanloom si") == ["simplify"]
    assert offered("scanloom lod ") == ["build", "info", "cut", "tiles"]
    assert offered("scanloom run x --unt") == ["--until"]
    assert offered("scanloom simplify a b --max-") == ["--max-shape", "--max-color"]
    assert offered("scanloom mesh p") == ["patches"]


def test_words_that_stand_for_something(offered: Offered) -> None:
    names = [stage.name for stage in STAGES]
    assert offered("scanloom run x --until ") == names
    assert offered("scanloom run x --quality ") == list(QUALITIES)
    assert offered("scanloom config --quality d") == ["draft"]
    assert "certified" in offered("scanloom simplify a b --method ")


def test_files_are_left_to_the_shell(offered: Offered) -> None:
    assert offered("scanloom run sam") == []
    assert offered("scanloom simplify ") == []
    assert offered("scanloom run x --config ") == []


def test_parameters_section_by_section(offered: Offered) -> None:
    own = ["limits", "run"]
    assert set(offered("scanloom run x --set ")) == {f"{one}." for one in [*own, *Config.get_types()]}
    assert set(offered("scanloom run x --set s")) == {"scan.", "simplify."}
    every = [f"report.{name}=" for name in describe_own(Config.get_types()["report"])]
    assert offered("scanloom run x --set rep") == offered("scanloom run x --set report.") == every
    assert offered("scanloom run x --set nothing") == offered("scanloom run x --set nothing.x") == []


def test_values_where_one_parameter_is_meant(offered: Offered) -> None:
    assert offered("scanloom run x --set report.page") == [
        *("report.page=", "report.page=true", "report.page=false"),
        "report.page_size=",
    ]
    # One alone would be taken, and a space put behind it.
    assert offered("scanloom run x --set fuse.voxel_s") == ["fuse.voxel_size=", "fuse.voxel_size=none"]
    assert offered("scanloom run x --set texture.alignment_i") == [
        "texture.alignment_iterations=",
        "texture.alignment_iterations=1",
    ]
    assert offered("scanloom run x --set simplify.jia01.p") == [
        *("simplify.jia01.paper_rule=", "simplify.jia01.paper_rule=true", "simplify.jia01.paper_rule=false")
    ]
    # zsh and fish take what is behind the sign for the same word.
    assert offered("scanloom run x --set fuse.device=c") == ["fuse.device=cpu", "fuse.device=cuda"]


def test_sections_of_a_command(offered: Offered) -> None:
    assert offered("scanloom fuse x y --set ") == ["scan.", "fuse."]
    assert offered("scanloom fuse x y --set fuse.trunc") == ["fuse.truncation=", "fuse.truncation=none"]
    assert offered("scanloom mesh patches x y --set noth") == []
    assert offered("scanloom mesh patches x y --set patches.noi") == [
        *("patches.noise_angle=", "patches.noise_angle=75.0")
    ]
    assert offered("scanloom compare x y --set vie") == ["views.views=", "views.view_width="]
    assert offered("scanloom config fus") == ["fuse"]


def test_what_is_offered_can_be_set() -> None:
    sections = config_sections()
    for section in Config.get_types():
        for word, _ in complete_assignment(f"{section}.", sections):
            values = [value for value, _ in complete_assignment(word, sections) if not value.endswith("=")]
            assert values
            Config().set(values[:1])
            Config().set(values[-1:])


SHELLS = {
    "bash": ".bash_completions/scanloom.sh",
    "zsh": ".zfunc/_scanloom",
    "fish": ".config/fish/completions/scanloom.fish",
}


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A home folder of its own, and a program `scanloom` to find."""
    program = tmp_path / "bin" / "scanloom"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m scanloom.cli.app "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    return tmp_path


def shell(*words: str) -> str:
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.slow
def test_bash_completes_once_it_is_installed(home: Path) -> None:
    assert "completion installed" in shell("scanloom", "--install-completion", "bash")
    assert SHELLS["bash"] in (home / ".bashrc").read_text()
    line = "COMP_WORDS=(scanloom run x --set cache.); COMP_CWORD=4; _scanloom_completion scanloom"
    text = shell("bash", "--norc", "-c", f'source ~/.bashrc; {line}; printf "%s|" "${{COMPREPLY[@]}}"')
    assert text.startswith("cache.max_size=|")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zsh", "fish"])
def test_it_installs_for_other_shells(home: Path, name: str) -> None:
    assert f"{name} completion installed" in shell("scanloom", "--install-completion", name)
    assert "scanloom" in (home / SHELLS[name]).read_text()
    if name == "fish" and shutil.which("fish"):
        script = home / SHELLS["fish"]
        line = f"source {script}; complete -C 'scanloom run x --quality d'"
        assert shell("fish", "--no-config", "-c", line).split("\t")[0].strip() == "draft"
