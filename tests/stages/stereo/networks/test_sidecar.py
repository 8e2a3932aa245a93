"""Sidecar files of networks: round trip, and one-sentence errors."""

from pathlib import Path

import pytest

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.stereo.networks.sidecar import Sidecar, format_sidecar, get_sidecar_path, read_sidecar

PAIR = 'kind = "stereo"\noutput = "d"\nunit = "px"\n[inputs]\na = "left"\nb = "right"\n'


def write_sidecar_file(tmp_path: Path, text: str) -> Path:
    network = tmp_path / "net.onnx"
    get_sidecar_path(network).write_text(text, encoding="utf-8")
    return network


@pytest.mark.parametrize(
    "sidecar",
    [
        Sidecar("stereo", {"a": "left", "b": "right"}, "d", "px"),
        Sidecar("stereo", {'odd "name': "pair"}, "d\\é", "normalised", sign=-1, occlusion="o", layout="nhwc"),
        Sidecar(
            "stereo", {"a": "left/2", "b": "right/2", "c": "left", "d": "right"}, "d", "px", multiple_of=8
        ),
        Sidecar(
            "monocular",
            {"image": "image"},
            "depth",
            "inverse_depth",
            color="bgr",
            range=(0.0, 1.0),
            mean=(0.406, 0.456, 0.485),
            std=(0.225, 0.224, 0.229),
            confidence="sure",
        ),
    ],
)
def test_a_written_sidecar_is_read_back(tmp_path, sidecar):
    assert read_sidecar(write_sidecar_file(tmp_path, format_sidecar(sidecar))) == sidecar


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("kind = ", "does not parse"),
        (PAIR.replace("unit", "units"), "unknown key 'units'; did you mean unit"),
        (PAIR.replace('unit = "px"\n', ""), "the required key unit is missing"),
        (PAIR.replace('"px"', '"feet"'), "unit is 'feet'; it must be one of px"),
        (PAIR.replace('"stereo"', '["stereo"]'), "kind is"),
        (PAIR.replace('"right"', '"image"'), "inputs.b is 'image'"),
        (PAIR.replace('"right"', '"left"'), "must include left and right"),
        (PAIR.replace('"right"', "3"), "inputs.b is 3"),
        ("range = [0, 0]\n" + PAIR, "two values of range must differ"),
        ("range = [0, nan]\n" + PAIR, "must be 2 numbers"),
        ("std = [1, 0, 1]\n" + PAIR, "above 0"),
        ("mean = 3\n" + PAIR, "must be 3 numbers"),
        ("sign = true\n" + PAIR, "must be 1 or -1"),
        ("multiple_of = 0\n" + PAIR, "must be from 1"),
        ('kind = "monocular"\noutput = "d"\nunit = "px"\n[inputs]\na = "image"\n', "inverse_depth or depth"),
        ('kind = "stereo"\noutput = "d"\nunit = "px"\ninputs = "left"\n', "must be a table"),
    ],
)
def test_invalid_sidecars_are_one_sentence(tmp_path, text, said):
    with pytest.raises(InputError) as caught:
        read_sidecar(write_sidecar_file(tmp_path, text))
    assert said in str(caught.value)
    assert "net.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_sidecar_is_an_error_with_a_remedy(tmp_path):
    with pytest.raises(InputError, match=r"scanloom lab probe net\.onnx --write"):
        read_sidecar(tmp_path / "net.onnx")
