"""Guessing a sidecar from a test pair with known shift."""

import onnx_networks
import pytest
from onnx import helper

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.stereo.networks import sidecar_guessing
from scanloom.stages.stereo.networks.sidecar_guessing import probe_network


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    monkeypatch.setattr(sidecar_guessing, "_TEST_SIZE", (96, 192))


@pytest.mark.parametrize(
    ("made", "wanted"),
    [
        ({}, {"range": (0.0, 255.0), "sign": 1, "unit": "px", "multiple_of": 32}),
        ({"scale": -1.0}, {"range": (0.0, 255.0), "sign": -1, "unit": "px"}),
        ({"low": 0.0, "high": 1.0}, {"range": (0.0, 1.0), "mean": (0.0,) * 3}),
        (
            {"scale": 1 / 256, "size": (128, 256)},
            {"unit": "normalised", "multiple_of": 1},
        ),
        ({"names": ("x", "y"), "swapped": True}, {"inputs": {"x": "right", "y": "left"}}),
    ],
)
def test_conventions_are_found(tmp_path, made, wanted):
    found = probe_network(onnx_networks.write_stereo_network(tmp_path / "net.onnx", **made))
    assert {name: getattr(found.sidecar, name) for name in wanted} == wanted
    assert found.error_px < 0.2
    assert any(text.startswith("bgr") for text in found.alternatives), (
        "which a network of grey cannot tell apart"
    )


def test_monocular_networks_get_the_usual_convention(tmp_path):
    found = probe_network(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))
    assert (found.sidecar.kind, found.sidecar.unit, found.error_px) == ("monocular", "inverse_depth", None)
    assert found.sidecar.inputs == {"image": "image"}


def test_a_network_that_finds_no_shift_has_no_guess(tmp_path):
    nodes = [helper.make_node("Sub", ["left", "right"], ["disparity"])]
    inputs = [(name, [1, 3, "h", "w"]) for name in ("left", "right")]
    file = onnx_networks.save_network(tmp_path / "net.onnx", nodes, inputs, [("disparity", None)])
    with pytest.raises(StageError, match="none of the common conventions"):
        probe_network(file)


def test_inputs_that_are_not_images(tmp_path):
    nodes = [helper.make_node("Identity", ["words"], ["out"])]
    file = onnx_networks.save_network(
        tmp_path / "net.onnx", nodes, [("words", [1, 512, 4, 4])], [("out", None)]
    )
    with pytest.raises(InputError, match="neither an image nor a pair"):
        probe_network(file)
