"""A user's network in a run: its part in cache keys, and measured depth is kept."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import onnx_networks
import pytest
from wall_photos import CAMERA, photos

from scanloom import InputError, ScanParams, read_scan
from scanloom.pipeline.config import Config
from scanloom.pipeline.run.dry_run import predict_run
from scanloom.pipeline.run.run import run
from scanloom.stages.scans.layouts.scan_json import write_scan_json
from scanloom.stages.scans.model.images import read_depth
from scanloom.stages.scans.model.scan import Frame
from scanloom.stages.stereo.networks.sidecar import Sidecar, format_sidecar, get_sidecar_path

ONE = Sidecar("monocular", {"image": "image"}, "depth", "inverse_depth", range=(0.0, 1.0))


@pytest.fixture
def scan(tmp_path: Path) -> Path:
    """Make two depth frames whose brightness encodes inverse depth; a part of the second has no depth."""
    folder, frames = tmp_path / "scan", []
    for number, frame in enumerate(photos(8)[:2]):
        random = np.random.default_rng(number)
        grey = random.integers(20, 230, (CAMERA.height, CAMERA.width)).astype(np.uint8)
        depth = np.rint(1000 / (0.2 + grey / 255.0)).astype(np.uint16)
        depth[: 20 * number] = 0
        paths = {}
        for what, image in (("color", np.repeat(grey[..., None], 3, axis=2)), ("depth", depth)):
            paths[what] = folder / what / f"{frame.name}.png"
            paths[what].parent.mkdir(parents=True, exist_ok=True)
            paths[what].write_bytes(cv2.imencode(".png", image)[1].tobytes())
        frames.append(Frame(frame.name, CAMERA, **paths, world_from_camera=frame.world_from_camera))
    write_scan_json(folder, frames)
    return folder


@pytest.fixture
def network(tmp_path: Path) -> Path:
    file = onnx_networks.write_brightness_network(tmp_path / "net.onnx")
    get_sidecar_path(file).write_text(format_sidecar(ONE), encoding="utf-8")
    return file


def config(network: Path, *more: str) -> Config:
    return Config().set([f"depth.model={network}", *more])


def predict_reasons(scan: Path, out: Path, network: Path, *more: str) -> dict[str, str]:
    foreseen = predict_run(scan, out, config(network, *more), until="depth")
    return {one.stage: one.reason for one in foreseen.stages if not one.cached}


def test_the_key_depends_on_network_and_sidecar_but_not_on_their_path(scan, network, tmp_path):
    out = tmp_path / "out"
    metrics = run(scan, out, config(network), until="depth").stages[0].metrics
    assert metrics["filled_ratio"] > 0.05
    assert predict_reasons(scan, out, network) == {}
    moved = tmp_path / "elsewhere" / "renamed.onnx"
    moved.parent.mkdir()
    shutil.move(network, moved)
    shutil.move(get_sidecar_path(network), get_sidecar_path(moved))
    assert predict_reasons(scan, out, moved) == {}
    assert predict_reasons(scan, out, moved, "depth.model_seconds=5", "depth.model_memory=4000") == {}
    assert predict_reasons(scan, out, moved, "depth.model_error=0.2")["depth"].startswith("params changed")
    text = get_sidecar_path(moved).read_text(encoding="utf-8")
    get_sidecar_path(moved).write_text(text + "\n", encoding="utf-8")
    assert "sidecar" in predict_reasons(scan, out, moved)["depth"]
    get_sidecar_path(moved).write_text(text, encoding="utf-8")
    onnx_networks.write_brightness_network(moved, scale=3.0)
    assert "network" in predict_reasons(scan, out, moved)["depth"]


def test_without_a_network_measured_depth_has_no_depth_stage(scan, tmp_path):
    assert "depth" not in {one.stage for one in predict_run(scan, tmp_path / "out", Config()).stages}


def test_measured_depth_is_kept_and_filled_depth_can_be_excluded(scan, network, tmp_path):
    run(scan, tmp_path / "out", config(network), until="depth")
    (entry,) = (tmp_path / "out" / "cache" / "depth").glob("*/**/scan.json")
    before, after = read_scan(scan), read_scan(entry.parent)
    for one, other in zip(before.frames, after.frames, strict=True):
        measured, whole = read_depth(one), read_depth(other)
        np.testing.assert_allclose(whole[measured > 0], measured[measured > 0], atol=1e-6)
    assert (whole > 0).mean() > (measured > 0).mean()
    document = json.loads(entry.read_text(encoding="utf-8"))
    names = [frame["confidence"] for frame in document["frames"]]
    trust = cv2.imread(str(entry.parent / names[1]), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(trust == 1, (whole > 0) & (measured == 0))
    surest = read_scan(entry.parent, ScanParams(min_confidence=2))
    np.testing.assert_array_equal(read_depth(surest.frames[1]) > 0, measured > 0)


def test_an_invalid_network_is_an_input_error(scan, network, tmp_path):
    network.write_bytes(b"no network")
    with pytest.raises(InputError, match="cannot be run as a network"):
        run(scan, tmp_path / "out", config(network), until="depth")
    with pytest.raises(InputError, match="no such file"):
        run(scan, tmp_path / "out", config(tmp_path / "none.onnx"), until="depth")
