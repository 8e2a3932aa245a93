"""Conversions of images and outputs as described by a sidecar."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import onnx_networks
import pytest
from onnx import TensorProto, helper

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.networks.process_pool import NetworkProcesses
from scanloom.stages.stereo.networks.sidecar import Sidecar
from scanloom.stages.stereo.networks.sidecar_guessing import make_test_pair

PAIR = Sidecar("stereo", {"left": "left", "right": "right"}, "disparity", "px", multiple_of=32)
ONE = Sidecar("monocular", {"image": "image"}, "depth", "inverse_depth")


def open_network(file: Path, sidecar: Sidecar) -> Network:
    return Network(file, 3 << 30, 60, sidecar)


def measure_error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.median(np.abs(found - truth)[np.isfinite(truth)]))


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ({}, {}),
        ({"scale": -1.0}, {"sign": -1}),
        ({"scale": 1 / 384}, {"unit": "normalised"}),
        ({"scale": 0.5}, {"unit": "inverse_depth"}),
        ({"low": -1.0, "high": 1.0}, {"range": (-1.0, 1.0)}),
        ({"low": -2.0, "high": 2.0}, {"range": (0.0, 1.0), "mean": (0.5,) * 3, "std": (0.25,) * 3}),
        ({"names": ("a", "b"), "swapped": True}, {"inputs": {"a": "right", "b": "left"}}),
        # Half the size, so half the disparity.
        ({"size": (128, 192)}, {"multiple_of": 1}),
    ],
)
def test_both_images_disparities_in_any_convention(tmp_path, made, said):
    left, right, truth = make_test_pair()
    network = open_network(
        onnx_networks.write_stereo_network(tmp_path / "net.onnx", **made), replace(PAIR, **said)
    )
    found = network.predict_pair(left, right, focal_baseline=2.0, offset=0.0)
    assert found.left.shape == found.right.shape == truth.shape
    assert measure_error(found.left, truth) < 0.1
    # A pixel of the left image corresponds to a right pixel shifted to the left by its disparity.
    rows, columns = np.nonzero(np.isfinite(truth))
    facing = found.right[rows, columns - truth[rows, columns].astype(int)]
    assert np.median(np.abs(facing - truth[rows, columns])) < 0.1
    assert (found.confidence == 1).all()


def test_an_image_of_another_multiple_is_padded_and_cropped(matching):
    left, right, truth = (image[:201, :363] for image in make_test_pair())
    found = Network.from_processes(matching, PAIR).predict_pair(left, right, 1.0, 0.0)
    assert found.left.shape == (201, 363)
    assert measure_error(found.left, truth) < 0.1


def test_colours_in_their_order_and_grey(tmp_path):
    weights = {"of": np.array([1, 10, 100], np.float32).reshape(1, 3, 1, 1)}
    nodes = [helper.make_node("Conv", ["image", "of"], ["depth"])]
    shape = [1, 3, "h", "w"]
    file = onnx_networks.save_network(
        tmp_path / "net.onnx", nodes, [("image", shape)], [("depth", None)], weights
    )
    image = np.zeros((8, 9, 3), np.uint8) + np.uint8([1, 2, 3])
    assert (open_network(file, ONE).predict_image(image)[0] == 321).all()
    assert (open_network(file, replace(ONE, color="bgr")).predict_image(image)[0] == 123).all()
    assert (open_network(file, ONE).predict_image(image[..., 0])[0] == 111).all(), (
        "a grey image is grey in all channels"
    )


def test_channels_last_other_types_and_half_size(tmp_path):
    shape = [1, "h", "w", 3]
    nodes = [
        helper.make_node("Cast", ["image"], ["float"], to=TensorProto.FLOAT),
        helper.make_node("ReduceMean", ["float"], ["mean"], axes=[3], keepdims=0),
        helper.make_node("Cast", ["mean"], ["depth"], to=TensorProto.FLOAT16),
    ]
    inputs = [("image", shape, TensorProto.UINT8)]
    outputs = [("depth", None, TensorProto.FLOAT16)]
    file = onnx_networks.save_network(tmp_path / "net.onnx", nodes, inputs, outputs)
    image = np.full((8, 10, 3), 7, np.uint8)
    image[:, :4] = 50
    found, mirrored = open_network(file, replace(ONE, layout="nhwc")).predict_image(image)
    np.testing.assert_array_equal(found, image[..., 0])
    np.testing.assert_array_equal(mirrored, found)
    half = replace(ONE, layout="nhwc", inputs={"image": "image/2"})
    assert open_network(file, half).predict_image(image)[0].shape == (8, 10), (
        "made as large as the image again"
    )


def test_confidence_and_occlusion(tmp_path):
    nodes = [
        helper.make_node("Slice", ["left", "at0", "at1", "axes"], ["disparity"]),
        helper.make_node("Slice", ["left", "at1", "at2", "axes"], ["sure"]),
        helper.make_node("Slice", ["left", "at2", "at3", "axes"], ["hidden"]),
        helper.make_node("Identity", ["right"], ["unused"]),
    ]
    weights = {f"at{k}": np.array([k], np.int64) for k in range(4)} | {"axes": np.array([1], np.int64)}
    inputs = [(name, [1, 3, "h", "w"]) for name in ("left", "right")]
    outputs = [(name, None) for name in ("disparity", "sure", "hidden", "unused")]
    file = onnx_networks.save_network(tmp_path / "net.onnx", nodes, inputs, outputs, weights)
    told = replace(PAIR, confidence="sure", occlusion="hidden", range=(0.0, 1.0), multiple_of=1)
    image = np.zeros((4, 5, 3), np.uint8) + np.uint8([255, 204, 51])
    found = open_network(file, told).predict_pair(image, image, 1.0, 0.0)
    np.testing.assert_allclose(found.confidence, 0.8 * 0.8, atol=1e-6)


@pytest.fixture(scope="module")
def matching(tmp_path_factory) -> NetworkProcesses:
    return NetworkProcesses(
        onnx_networks.write_stereo_network(tmp_path_factory.mktemp("made") / "net.onnx"), 3 << 30, 60
    )


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"output": "disp"}, "the network has no output 'disp', only disparity"),
        ({"inputs": {"left": "left", "rigth": "right"}}, "but the network has left, right"),
        ({"inputs": {"left": "pair"}}, "but the network has left, right"),
        ({"color": "grey"}, "has 1 channels"),
    ],
)
def test_a_sidecar_of_another_network(matching, changes, said):
    with pytest.raises(InputError) as caught:
        Network.from_processes(matching, replace(PAIR, **changes))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("node", "said"),
    [
        (helper.make_node("ReduceMean", ["image"], ["depth"]), "has shape 1 × 1 × 1 × 1 for an image of"),
        (helper.make_node("Flatten", ["image"], ["depth"]), "not a map of the image"),
        (helper.make_node("Div", ["zero", "zero"], ["depth"]), "has no finite values"),
    ],
)
def test_outputs_that_are_not_maps(tmp_path, node, said):
    nodes = [helper.make_node("Sub", ["image", "image"], ["zero"]), node]
    file = onnx_networks.save_network(
        tmp_path / "net.onnx", nodes, [("image", [1, 3, "h", "w"])], [("depth", None)]
    )
    with pytest.raises(InputError) as caught:
        open_network(file, ONE).predict_image(np.zeros((20, 30, 3), np.uint8))
    assert said in str(caught.value)
