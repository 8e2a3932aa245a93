"""Depth by a user's network: it passes the same consistency check, and only fills missing depth."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import onnx_networks
import pytest
from onnx import helper

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.scans.model.scan import Camera, Frame, Scan, StereoRig
from scanloom.stages.scans.reader import read_scan
from scanloom.stages.stereo.codes import DEPTH_NETWORK_SIDECAR_INVALID
from scanloom.stages.stereo.depth import depth, depth_scan
from scanloom.stages.stereo.depth_completion import completed_scan
from scanloom.stages.stereo.depth_filling import FILLED_CONFIDENCE
from scanloom.stages.stereo.depth_map import DepthMap
from scanloom.stages.stereo.network_depth import fill_missing_depth, load_network
from scanloom.stages.stereo.networks.sidecar import Sidecar, format_sidecar, get_sidecar_path
from scanloom.stages.stereo.networks.sidecar_guessing import make_test_pair
from scanloom.stages.stereo.opencv_matching import SearchRange
from scanloom.stages.stereo.params import DepthParams

PAIR = Sidecar("stereo", {"left": "left", "right": "right"}, "disparity", "px", multiple_of=32)
ONE = Sidecar("monocular", {"image": "image"}, "depth", "inverse_depth", range=(0.0, 1.0))
LEFT, RIGHT, TRUTH = (image[:160, :256] for image in make_test_pair())
CAMERA = Camera(256, 160, 200.0, 200.0, 127.5, 79.5)
RIG = StereoRig(CAMERA, CAMERA, np.array([[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]]), True)


def write_sidecar(file: Path, sidecar: Sidecar) -> str:
    get_sidecar_path(file).write_text(format_sidecar(sidecar), encoding="utf-8")
    return str(file)


@pytest.fixture(scope="module")
def matcher(tmp_path_factory) -> str:
    return write_sidecar(
        onnx_networks.write_stereo_network(tmp_path_factory.mktemp("made") / "net.onnx"), PAIR
    )


@pytest.fixture(scope="module")
def by_brightness(tmp_path_factory) -> str:
    return write_sidecar(
        onnx_networks.write_brightness_network(tmp_path_factory.mktemp("made") / "one.onnx"), ONE
    )


def test_a_networks_depth_is_true(matcher):
    found = depth(LEFT, RIGHT, RIG, model=matcher, max_relative_depth_error=1.0)
    there = (found.depth > 0) & np.isfinite(TRUTH)
    assert np.mean(there[np.isfinite(TRUTH)]) > 0.8
    assert np.mean(np.abs(found.disparity[there] - TRUTH[there]) > 1) < 0.02
    np.testing.assert_allclose(found.depth[there], 20 / found.disparity[there], rtol=1e-5)
    assert found.diagnostics == ()
    # Pixels occluded in the right image are behind the left side of the rectangle.
    rows, columns = np.nonzero(~np.isfinite(TRUTH[40:120, 70:]))
    assert np.mean(found.depth[rows + 40, columns + 70] > 0) < 0.2


def test_inconsistent_left_and_right_disparity_gives_no_depth(tmp_path):
    # A network whose output only depends on the left image.
    weights = {"of": np.full((1, 3, 1, 1), 0.05, np.float32)}
    nodes = [
        helper.make_node("Conv", ["left", "of"], ["disparity"]),
        helper.make_node("Identity", ["right"], ["unused"]),
    ]
    inputs = [(name, [1, 3, "h", "w"]) for name in ("left", "right")]
    outputs = [("disparity", None), ("unused", None)]
    file = onnx_networks.save_network(tmp_path / "net.onnx", nodes, inputs, outputs, weights)
    found = depth(LEFT, RIGHT, RIG, model=write_sidecar(file, PAIR), max_relative_depth_error=1.0)
    assert np.mean(found.depth > 0) < 0.05


def test_a_wrong_sign_is_reported(tmp_path):
    file = onnx_networks.write_stereo_network(tmp_path / "net.onnx", scale=-1.0)
    found = depth(LEFT, RIGHT, RIG, model=write_sidecar(file, PAIR))
    assert not found.depth.any()
    (diagnostic,) = found.diagnostics
    assert diagnostic.code == DEPTH_NETWORK_SIDECAR_INVALID.name
    assert str(diagnostic) == (
        "net.onnx: almost no pixel passes the left–right check with this network; check unit, sign, range "
        "and inputs in its sidecar, or guess them with scanloom lab probe"
    )


def test_results_do_not_depend_on_the_number_of_threads(matcher):
    frames = [Frame(str(k), CAMERA, color=LEFT, right=RIGHT) for k in range(3)]
    runs = [
        [found.depth for _, found in depth_scan(Scan("made", frames, RIG), model=matcher, threads=threads)]
        for threads in (1, 3)
    ]
    assert all(np.array_equal(one, other) for one, other in zip(*runs, strict=True))


def test_matcher_options_are_refused_with_a_network(matcher):
    with pytest.raises(UsageError, match=r"sgbm\.block_size has no effect with a stereo network"):
        depth(LEFT, RIGHT, RIG, model=matcher, sgbm={"block_size": 5, "uniqueness": 3})


def make_depth_map(depth_map: np.ndarray, color: np.ndarray) -> DepthMap:
    trust = np.where(depth_map > 0, np.uint8(200), np.uint8(0))
    nothing = np.full(depth_map.shape, np.nan, np.float32)
    search = SearchRange(0, 0)
    return DepthMap(depth_map, trust, nothing, color, CAMERA, np.eye(3), search, 0.1, 10.0)


def make_brightness_scene() -> tuple[np.ndarray, np.ndarray]:
    """Make depth, and an image whose brightness is linear in inverse depth within 8 bits."""
    random = np.random.default_rng(2)
    grey = random.integers(20, 230, (160, 256)).astype(np.uint8)
    return (1 / (0.2 + grey / 255.0)).astype(np.float32), np.repeat(grey[..., None], 3, axis=2)


def test_a_monocular_network_fills_missing_depth(by_brightness):
    truth, color = make_brightness_scene()
    measured = truth.copy()
    measured[:, 100:180] = 0
    # A third of the measured depth is wrong.
    wrong = np.random.default_rng(3).random(truth.shape) < 0.33
    measured[wrong & (measured > 0)] *= 3
    params = DepthParams(model=by_brightness)
    found = fill_missing_depth(make_depth_map(measured, color), load_network(params), params)
    np.testing.assert_array_equal(found.depth[measured > 0], measured[measured > 0])
    filled = found.filled
    assert not filled[measured > 0].any()
    assert np.mean(filled[:, 100:180]) > 0.95
    np.testing.assert_allclose(found.depth[filled], truth[filled], rtol=0.01)
    assert (found.confidence[filled] == FILLED_CONFIDENCE).all()
    assert found.to_dict()["filled_ratio"] == filled.mean()


def test_nothing_is_filled_beyond_the_measured_range(by_brightness):
    truth, color = make_brightness_scene()
    measured = np.where(truth < 1.5, truth, np.float32(0))
    params = DepthParams(model=by_brightness)
    found = fill_missing_depth(make_depth_map(measured, color), load_network(params), params)
    assert found.depth.max() <= 1.51


def test_depth_contradicted_by_the_mirrored_image_is_not_filled(tmp_path):
    # Brightness plus a ramp towards the right, which does not exist in the scene.
    ramp = np.linspace(0, 3, 256, dtype=np.float32).reshape(1, 1, 1, -1)
    nodes = [
        helper.make_node("ReduceMean", ["image"], ["mean"], axes=[1]),
        helper.make_node("Mul", ["mean", "ramp"], ["depth"]),
    ]
    shape = [1, 3, 160, 256]
    file = onnx_networks.save_network(
        tmp_path / "net.onnx", nodes, [("image", shape)], [("depth", None)], {"ramp": ramp}
    )
    truth, color = make_brightness_scene()
    # Measured in the middle, where both agree.
    measured = np.where(np.abs(np.arange(256) - 127.5) < 20, truth, np.float32(0))
    params = DepthParams(model=write_sidecar(file, ONE), model_error=0.05)
    found = fill_missing_depth(make_depth_map(measured, color), load_network(params), params)
    assert found.filled[:, :80].mean() < 0.02


def test_a_poor_fit_is_rejected_and_reported(by_brightness):
    truth, color = make_brightness_scene()
    params = DepthParams(model=by_brightness)
    network = load_network(params)
    for depth_map, why in (
        (np.where(truth > 9, truth, np.float32(0)), "too few pixels have measured depth"),
        (truth[:, ::-1].copy(), "model_error"),
        ((3 - 0.5 * truth).astype(np.float32), "order is inverted"),
    ):
        measured = make_depth_map(np.where(np.arange(256) % 9 == 0, np.float32(0), depth_map), color)
        with collecting() as diagnostics:
            found = fill_missing_depth(measured, network, params)
        np.testing.assert_array_equal(found.depth, measured.depth)
        assert not found.filled.any()
        (diagnostic,) = diagnostics
        assert str(diagnostic).startswith("one.onnx: the network fills no depth in some images: ")
        assert why in str(diagnostic)


def test_sensor_depth_is_filled_and_photos_are_kept(by_brightness):
    truth, color = make_brightness_scene()
    measured = truth.copy()
    measured[50:90] = 0
    mask = np.full(truth.shape, 255, np.uint8)
    mask[:, :30] = 0
    photo = np.repeat(np.repeat(color, 2, axis=0), 2, axis=1)
    frames = [Frame("a", CAMERA, color=photo, depth=measured, mask=mask)]
    ((frame, found),) = completed_scan(Scan("made", frames), model=by_brightness)
    assert frame.color.shape == (320, 512, 3)
    np.testing.assert_array_equal(frame.mask, mask)
    assert not found.depth[:, :30].any()
    assert found.filled[50:90, 30:].mean() > 0.9
    np.testing.assert_allclose(found.depth[found.filled], truth[found.filled], rtol=0.01)


def test_a_stereo_network_fills_nothing(matcher):
    truth, color = make_brightness_scene()
    scan = Scan("made", [Frame("a", CAMERA, color=color, depth=truth)])
    with pytest.raises(UsageError, match="is a stereo network"):
        next(completed_scan(scan, model=matcher))
    with pytest.raises(UsageError, match="only a monocular network"):
        next(completed_scan(scan))


def test_without_a_file_or_a_sidecar(tmp_path):
    with pytest.raises(InputError, match="there is no such file"):
        load_network(DepthParams(model=str(tmp_path / "net.onnx")))
    onnx_networks.write_brightness_network(tmp_path / "net.onnx")
    with pytest.raises(InputError, match=r"its sidecar net\.toml"):
        load_network(replace(DepthParams(), model=str(tmp_path / "net.onnx")))


@pytest.mark.slow
def test_a_matcher_of_twelve_nodes_on_a_real_pair(tmp_path, shared_data):
    folder = shared_data / "stereo" / "middlebury2014_motorcycle"
    rig = read_scan(folder).rig
    left, right = (cv2.imread(str(folder / f"im{k}.png"))[..., ::-1].copy() for k in (0, 1))
    truth = cv2.imread(str(folder / "disp0.pfm"), cv2.IMREAD_UNCHANGED)
    file = onnx_networks.write_stereo_network(tmp_path / "net.onnx", disparities=80, window=9, sharpness=4.0)
    found = depth(left, right, rig, model=write_sidecar(file, PAIR))
    there = (found.depth > 0) & np.isfinite(truth)
    assert there.mean() > 0.35
    assert np.mean(np.abs(found.disparity[there] - truth[there]) > 2) < 0.04
