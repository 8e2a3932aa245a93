"""Command `lab probe`, and option `depth --model`."""

import json
from pathlib import Path

import onnx_networks
import pytest

from scanloom.cli.app import run_command
from scanloom.stages.stereo.networks import sidecar_guessing
from scanloom.stages.stereo.networks.sidecar import Sidecar, format_sidecar, get_sidecar_path, read_sidecar


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(sidecar_guessing, "_TEST_SIZE", (96, 192))


def test_probe_prints_the_sidecar_or_writes_it(tmp_path: Path, capsys):
    network = onnx_networks.write_stereo_network(tmp_path / "net.onnx", scale=-1.0)
    assert run_command(["lab", "probe", str(network)]) == 0
    printed = capsys.readouterr().out
    assert not get_sidecar_path(network).exists()
    assert run_command(["lab", "probe", str(network), "--write", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert get_sidecar_path(network).read_text(encoding="utf-8").strip() == printed.strip()
    assert result["sidecar"]["sign"] == read_sidecar(network).sign == -1
    assert run_command(["lab", "probe", str(network), "--write"]) == 3
    assert "this file already exists" in capsys.readouterr().err


def test_probe_warns_about_a_network_for_single_images(tmp_path: Path, capsys):
    network = onnx_networks.write_brightness_network(tmp_path / "net.onnx")
    assert run_command(["lab", "probe", str(network), "--strict"]) == 1
    assert "a network for single images cannot be probed" in capsys.readouterr().err


def test_a_damaged_network_is_bad_input(tmp_path: Path, capsys):
    (tmp_path / "net.onnx").write_bytes(b"no network")
    assert run_command(["lab", "probe", str(tmp_path / "net.onnx")]) == 3
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.slow
def test_depth_uses_a_network_instead_of_the_matcher(tmp_path: Path, capsys):
    samples = Path(__file__).resolve().parents[2] / "samples"
    pairs = Sidecar("stereo", {"left": "left", "right": "right"}, "disparity", "px", multiple_of=32)
    network = onnx_networks.write_stereo_network(tmp_path / "net.onnx", disparities=96, sharpness=4.0)
    get_sidecar_path(network).write_text(format_sidecar(pairs), encoding="utf-8")
    words = ["--set", "scan.last=0", "--model", str(network), "--json"]
    assert run_command(["depth", str(samples / "stereo"), str(tmp_path / "out"), *words]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["used_ratio"] > 0.4
    assert 0.7 < result["median_depth_m"] < 1.2
    assert run_command(["depth", str(samples / "rgbd"), str(tmp_path / "no"), *words]) == 2
    assert "is a stereo network" in capsys.readouterr().err


@pytest.mark.parametrize("path", ["", "nix.onnx"])
def test_a_missing_network_is_one_error(path: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["lab", "probe", path]) == 3
    assert capsys.readouterr().err.count("\n") == 1
