"""Shell completion: proposals for an unfinished line, and installation."""

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
def complete_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Offered:
    """Return a function that lists the completions of bash for a line.

    The last word is completed, unless the line ends with a space.
    """

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


def test_commands_and_options_are_completed(complete_line: Offered) -> None:
    commands = [name for of_panel in COMMANDS.values() for name in of_panel]
    assert set(complete_line("scanloom ")) == set(commands)
    assert complete_line("scanloom si") == ["simplify"]
    assert complete_line("scanloom lod ") == ["build", "info", "cut", "tiles"]
    assert complete_line("scanloom run x --unt") == ["--until"]
    assert complete_line("scanloom simplify a b --max-") == ["--max-shape", "--max-color"]
    assert complete_line("scanloom mesh p") == ["patches"]


def test_enumerated_values_are_completed(complete_line: Offered) -> None:
    names = [stage.name for stage in STAGES]
    assert complete_line("scanloom run x --until ") == names
    assert complete_line("scanloom run x --quality ") == list(QUALITIES)
    assert complete_line("scanloom config --quality d") == ["draft"]
    assert "certified" in complete_line("scanloom simplify a b --method ")


def test_file_names_are_left_to_the_shell(complete_line: Offered) -> None:
    assert complete_line("scanloom run sam") == []
    assert complete_line("scanloom simplify ") == []
    assert complete_line("scanloom run x --config ") == []


def test_parameters_are_completed_section_by_section(complete_line: Offered) -> None:
    own = ["limits", "run"]
    assert set(complete_line("scanloom run x --set ")) == {f"{one}." for one in [*own, *Config.get_types()]}
    assert set(complete_line("scanloom run x --set s")) == {"scan.", "simplify.", "structure."}
    every = [f"report.{name}=" for name in describe_own(Config.get_types()["report"])]
    assert complete_line("scanloom run x --set rep") == complete_line("scanloom run x --set report.") == every
    assert (
        complete_line("scanloom run x --set nothing") == complete_line("scanloom run x --set nothing.x") == []
    )


def test_values_are_completed_for_a_single_parameter(complete_line: Offered) -> None:
    assert complete_line("scanloom run x --set report.page") == [
        *("report.page=", "report.page=true", "report.page=false"),
        "report.page_size=",
    ]
    # Bash would accept a single proposal and append a space, so two are offered.
    assert complete_line("scanloom run x --set fuse.voxel_s") == ["fuse.voxel_size=", "fuse.voxel_size=none"]
    assert complete_line("scanloom run x --set texture.alignment_i") == [
        "texture.alignment_iterations=",
        "texture.alignment_iterations=1",
    ]
    assert complete_line("scanloom run x --set simplify.jia01.p") == [
        *("simplify.jia01.paper_rule=", "simplify.jia01.paper_rule=true", "simplify.jia01.paper_rule=false")
    ]
    # zsh and fish regard the text after the equals sign as part of the same word.
    assert complete_line("scanloom run x --set fuse.device=c") == ["fuse.device=cpu", "fuse.device=cuda"]


def test_a_command_completes_only_its_sections(complete_line: Offered) -> None:
    assert complete_line("scanloom fuse x y --set ") == ["scan.", "fuse."]
    assert complete_line("scanloom fuse x y --set fuse.trunc") == ["fuse.truncation=", "fuse.truncation=none"]
    assert complete_line("scanloom mesh patches x y --set noth") == []
    assert complete_line("scanloom mesh patches x y --set patches.noi") == [
        *("patches.noise_angle=", "patches.noise_angle=75.0")
    ]
    assert complete_line("scanloom compare x y --set vie") == ["views.views=", "views.view_width="]
    assert complete_line("scanloom config fus") == ["fuse"]


def test_all_completions_are_valid_assignments() -> None:
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
    """Prepare an empty home folder and a program `scanloom` on PATH."""
    program = tmp_path / "bin" / "scanloom"
    program.parent.mkdir()
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -m scanloom.cli.app "$@"\n')
    program.chmod(0o755)
    monkeypatch.setenv("PATH", f"{program.parent}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION", "1")
    return tmp_path


def run_program(*words: str) -> str:
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


@pytest.mark.slow
def test_bash_completes_after_installation(home: Path) -> None:
    assert "completion installed" in run_program("scanloom", "--install-completion", "bash")
    assert SHELLS["bash"] in (home / ".bashrc").read_text()
    line = "COMP_WORDS=(scanloom run x --set cache.); COMP_CWORD=4; _scanloom_completion scanloom"
    text = run_program("bash", "--norc", "-c", f'source ~/.bashrc; {line}; printf "%s|" "${{COMPREPLY[@]}}"')
    assert text.startswith("cache.max_size=|")


@pytest.mark.slow
@pytest.mark.parametrize("name", ["zsh", "fish"])
def test_completion_installs_for_other_shells(home: Path, name: str) -> None:
    assert f"{name} completion installed" in run_program("scanloom", "--install-completion", name)
    assert "scanloom" in (home / SHELLS[name]).read_text()
    if name == "fish" and shutil.which("fish"):
        script = home / SHELLS["fish"]
        line = f"source {script}; complete -C 'scanloom run x --quality d'"
        assert run_program("fish", "--no-config", "-c", line).split("\t")[0].strip() == "draft"
