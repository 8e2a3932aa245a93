"""Commands, parameters and paths in the README and other pages exist, and the README's Python code runs."""

import os
import re
from pathlib import Path

import pytest
from small_sample import write_small_sample

from scanloom.cli.sections import command_sections
from scanloom.pipeline.config import Config
from scanloom.stages.params import describe_all

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text()
DOCS = tuple(sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "docs").rglob("*.md")))
MANUAL = "\n".join([TEXT, *((ROOT / page).read_text() for page in DOCS)])
PAGES = ("README.md", "CONTRIBUTING.md", "samples/README.md")
ROOMS = r"(?:cli|pipeline|stages|kernels|tests|benches|samples)"


def test_every_parameter_in_the_readme_exists():
    known = {name: set(describe_all(cls)) for name, cls in Config.get_types().items()}
    for one in command_sections():
        known[one.name] = known.get(one.name, set()) | one.names
    sections = "|".join(known)
    named = re.findall(
        rf"`({sections})\.(?!(?:\w+\.)?(?:json|ply|txt|slod|glb|html|md|csv|parquet)\b)([\w.]+)(?:=[^`]*)?`",
        MANUAL,
    )
    assert len(named) > 60
    for section, name in named:
        assert name in known[section], f"{section}.{name}"


@pytest.mark.slow
def test_python_code_in_the_readme_runs(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    write_small_sample(tmp_path / "samples" / "rgbd")
    monkeypatch.chdir(tmp_path)

    exec(compile(code, "README.md", "exec"), {})

    assert (tmp_path / "light.ply").stat().st_size > 10_000
    assert "stopped_by" in capsys.readouterr().out


def test_every_command_in_the_readme_exists():
    from typer.main import get_command

    from scanloom.cli.app import app

    known = set(get_command(app()).commands)  # type: ignore[attr-defined]
    named = set(re.findall(r"(?:^|`)scanloom ([a-z]+)", MANUAL, flags=re.MULTILINE))
    assert named
    assert named <= known


def test_the_readme_is_short_and_links_to_every_page():
    assert len(TEXT.splitlines()) <= 150
    reached, ahead = set(), ["README.md"]
    while ahead:
        page = ahead.pop()
        reached.add(page)
        links = re.findall(r"\]\(([\w./-]+\.md)(?:#[\w-]*)?\)", (ROOT / page).read_text())
        targets = {os.path.normpath(Path(page).parent / link) for link in links}
        ahead += sorted(targets & set(DOCS) - reached)
    assert set(DOCS) <= reached


@pytest.mark.parametrize("page", [*PAGES, *DOCS])
def test_every_path_on_a_page_exists(page: str):
    text = (ROOT / page).read_text()
    named = {path.rstrip(".") for path in re.findall(rf"(?<![\w./-]){ROOMS}/[\w./-]*", text)}
    # NAME is a placeholder of the reader; its folder must exist.
    named = {re.sub(r"\bNAME.*", "", path) for path in named}
    linked = {(Path(page).parent / link).as_posix() for link in re.findall(r"\]\(([\w./-]+)\)", text)}

    assert named or page in DOCS
    # Pages of docs/ may use paths relative to themselves.
    page_folder = (ROOT / page).parent
    missing = {path for path in named if not (ROOT / path).exists() and not (page_folder / path).exists()}
    missing |= {path for path in linked if not (ROOT / path).exists()}
    assert not missing


@pytest.mark.parametrize("page", PAGES[:2])
def test_every_make_target_on_a_page_exists(page: str):
    text = (ROOT / page).read_text()
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE))

    named = set(re.findall(r"(?:^|`)make ([a-z-]+)", text, flags=re.MULTILINE))

    assert named
    assert named <= targets
