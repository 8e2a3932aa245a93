"""The README's Python runs, and the parameters it names exist."""

import re
from pathlib import Path

import pytest

from pipeline.config import Config
from stages.params import described

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "README.md").read_text()


def test_every_parameter_it_names_exists():
    config = Config()
    named = re.findall(r"`(depth|fuse|clean|simplify|remesh|compare|report)\.(?!json\b)(\w+)`", TEXT)
    assert len(named) > 15
    for section, name in named:
        assert name in described(type(getattr(config, section))), f"{section}.{name}"


def test_its_python_runs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (code,) = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)
    (tmp_path / "samples").symlink_to(ROOT / "samples")
    monkeypatch.chdir(tmp_path)

    exec(compile(code, "README.md", "exec"), {})

    assert (tmp_path / "light.ply").stat().st_size > 10_000
    assert "stopped_by" in capsys.readouterr().out


def test_every_command_it_names_exists():
    from typer.main import get_command

    from cli.app import app

    known = set(get_command(app).commands)  # type: ignore[attr-defined]
    named = set(re.findall(r"^scanloom (\w+)", TEXT, flags=re.MULTILINE))
    assert named
    assert named <= known


def test_every_bench_it_names_exists():
    named = set(re.findall(r"benches/\w+\.py", TEXT))
    assert named
    assert all((ROOT / name).is_file() for name in named)
