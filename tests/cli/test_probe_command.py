"""`scanloom lab probe`, and `depth --model` on the command line."""

import json
from pathlib import Path

import networks
import pytest

from scanloom.cli.app import run_command
from scanloom.stages.stereo.networks import probe
from scanloom.stages.stereo.networks.sidecar import Sidecar, read_sidecar, sidecar_of, written


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(probe, "_SIZE", (96, 192))


def test_it_prints_the_page_or_writes_it(tmp_path: Path, capsys):
    network = networks.matcher(tmp_path / "net.onnx", scale=-1.0)
    assert run_command(["lab", "probe", str(network)]) == 0
    printed = capsys.readouterr().out
    assert not sidecar_of(network).exists()
    assert run_command(["lab", "probe", str(network), "--write", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert sidecar_of(network).read_text(encoding="utf-8").strip() == printed.strip()
    assert told["sidecar"]["sign"] == read_sidecar(network).sign == -1
    assert run_command(["lab", "probe", str(network), "--write"]) == 3
    assert "is there already" in capsys.readouterr().err


def test_what_is_only_custom_is_warned_of(tmp_path: Path, capsys):
    network = networks.by_brightness(tmp_path / "net.onnx")
    assert run_command(["lab", "probe", str(network), "--strict"]) == 1
    assert "of one image no shift is known" in capsys.readouterr().err


def test_no_network_is_bad_input(tmp_path: Path, capsys):
    (tmp_path / "net.onnx").write_bytes(b"no network")
    assert run_command(["lab", "probe", str(tmp_path / "net.onnx")]) == 3
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_a_network_takes_the_matchers_place(tmp_path: Path, capsys):
    samples = Path(__file__).resolve().parents[2] / "samples"
    pairs = Sidecar("stereo", {"left": "left", "right": "right"}, "disparity", "px", multiple_of=32)
    network = networks.matcher(tmp_path / "net.onnx", disparities=96, sharpness=4.0)
    sidecar_of(network).write_text(written(pairs), encoding="utf-8")
    words = ["--set", "scan.last=0", "--model", str(network), "--json"]
    assert run_command(["depth", str(samples / "stereo"), str(tmp_path / "out"), *words]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["used_share"] > 0.4
    assert 0.7 < told["median_depth_m"] < 1.2
    assert run_command(["depth", str(samples / "rgbd"), str(tmp_path / "no"), *words]) == 2
    assert "is a stereo network" in capsys.readouterr().err


@pytest.mark.parametrize("path", ["", "nix.onnx"])
def test_what_is_no_file_is_a_sentence(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["lab", "probe", path]) == 3
    assert capsys.readouterr().err.count("\n") == 1
