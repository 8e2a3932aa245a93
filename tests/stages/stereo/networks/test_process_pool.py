"""Files of networks that come from anywhere: each is run, or is one sentence; nothing crashes or hangs."""

import gc
import os
import random
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import onnx
import onnx_networks
import pytest
from onnx import TensorProto, helper

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.stereo.networks import process_pool
from scanloom.stages.stereo.networks.process_pool import NetworkProcesses

IMAGE = ("image", [1, 3, "h", "w"])
FEED = {"image": np.ones((1, 3, 20, 30), np.float32)}


def opened(file: Path, memory: int = 3 << 30, seconds: float = 60) -> NetworkProcesses:
    return NetworkProcesses(file, memory, seconds)


def refused(file: Path, **limits: float) -> str:
    """What is said of a file that cannot be loaded or run."""
    with pytest.raises(InputError) as caught:
        opened(file, **limits).run(FEED, ["depth"])
    said = str(caught.value)
    assert said.startswith(f"{file}: cannot be run as a network: ")
    assert "\n" not in said
    assert len(said) < 500
    return said


def graph(file: Path, *nodes: onnx.NodeProto, weights=(), output=None) -> Path:
    return onnx_networks.save_network(file, nodes, [IMAGE], [("depth", output)], weights)


def test_it_tells_what_it_takes_and_is_run_many_times(tmp_path):
    one = opened(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))
    assert one.inputs == [{"name": "image", "shape": [1, 3, None, None], "type": "tensor(float)"}]
    assert [told["name"] for told in one.outputs] == ["depth"]
    for size in ((4, 5), (30, 7)):
        image = np.random.default_rng(1).random((1, 3, *size), np.float32)
        (found,) = one.run({"image": image}, ["depth"])
        np.testing.assert_allclose(found[0, 0], 5 + 2 * image[0].mean(axis=0), rtol=1e-5)


def test_several_at_once_say_the_same(tmp_path):
    one = opened(onnx_networks.write_stereo_network(tmp_path / "net.onnx"))
    pair = np.random.default_rng(1).random((2, 1, 3, 40, 60), np.float32) * 255
    feeds = {"left": pair[0], "right": pair[1]}
    alone = one.run(feeds, ["disparity"])[0]
    with ThreadPoolExecutor(3) as threads:
        for (found,) in threads.map(lambda _: one.run(feeds, ["disparity"]), range(6)):
            assert found.tobytes() == alone.tobytes()


def test_processes_end_with_their_owner(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    one = opened(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))
    child = one._idle[0]._child
    del one
    gc.collect()
    assert child.returncode is not None
    assert [path.name for path in tmp_path.iterdir()] == ["net.onnx"]


def test_damaged_files(tmp_path):
    good = onnx_networks.write_stereo_network(tmp_path / "good.onnx").read_bytes()
    noise = random.Random(5)
    file = tmp_path / "bad.onnx"
    damaged = bytearray(good)
    for _ in range(30):
        damaged[noise.randrange(len(damaged))] = noise.randrange(256)
    for data in (b"", b"no network", good[: len(good) // 2], bytes(damaged)):
        file.write_bytes(data)
        refused(file)


def test_weights_in_other_files_are_not_read(tmp_path):
    (tmp_path / "weights").write_bytes(np.float32(2).tobytes())
    file = graph(
        tmp_path / "net.onnx", helper.make_node("Mul", ["image", "w"], ["depth"]), weights={"w": 2.0}
    )
    for place in ("weights", str(tmp_path / "weights"), "../../weights"):
        model = onnx.load(file)
        (weight,) = model.graph.initializer
        weight.ClearField("raw_data")
        weight.data_type, weight.data_location = TensorProto.FLOAT, TensorProto.EXTERNAL
        del weight.external_data[:]
        weight.external_data.add(key="location", value=place)
        other = tmp_path / "other.onnx"
        other.write_bytes(model.SerializeToString())
        assert "weights in other files" in refused(other)


def test_one_that_asks_for_all_memory(tmp_path):
    size = helper.make_tensor("v", TensorProto.INT64, [2], [200_000, 200_000])
    file = graph(
        tmp_path / "net.onnx",
        helper.make_node("Constant", [], ["size"], value=size),
        helper.make_node("ConstantOfShape", ["size"], ["all"]),
        helper.make_node("ReduceMean", ["all"], ["mean"]),
        helper.make_node("Add", ["image", "mean"], ["depth"]),
    )
    assert "exceeds the memory limit (depth.model_memory)" in refused(file)


def test_one_that_never_ends(tmp_path, monkeypatch):
    cond = [helper.make_tensor_value_info(name, TensorProto.BOOL, []) for name in ("c", "go_on")]
    number = helper.make_tensor_value_info("i", TensorProto.INT64, [])
    values = [helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in ("v", "next")]
    body = helper.make_graph(
        [helper.make_node("Identity", ["c"], ["go_on"]), helper.make_node("Sin", ["v"], ["next"])],
        "body",
        [number, cond[0], values[0]],
        [cond[1], values[1]],
    )
    forever = helper.make_node("Loop", ["", "yes", "image"], ["depth"], body=body)
    file = graph(tmp_path / "net.onnx", forever, weights={"yes": np.array(True)})
    started = time.monotonic()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert "exceeds the time limit of 2 s (depth.model_seconds)" in refused(file, seconds=2)
    assert time.monotonic() - started < 10
    gc.collect()
    assert [path.name for path in tmp_path.iterdir()] == ["net.onnx"]


def test_outputs_that_are_no_map_of_numbers(tmp_path):
    wide = helper.make_node("Tile", ["image", "times"], ["depth"])
    file = graph(tmp_path / "net.onnx", wide, weights={"times": np.array([1, 1, 10, 10], np.int64)})
    assert "values for" in refused(file)
    truth = graph(tmp_path / "truth.onnx", helper.make_node("IsNaN", ["image"], ["told"]))
    model = onnx.load(truth)
    model.graph.output[0].name, model.graph.output[0].type.tensor_type.elem_type = "told", TensorProto.BOOL
    truth.write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match="type bool"):
        opened(truth).run(FEED, ["told"])


def test_without_onnxruntime_it_says_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setattr(process_pool, "find_spec", {}.get)
    with pytest.raises(UsageError, match=r"install scanloom\[network\]"):
        opened(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))


def test_no_file_a_folder_and_a_pipe(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        opened(tmp_path / "none.onnx")
    with pytest.raises(InputError, match="no such file"):
        opened(tmp_path)
    os.mkfifo(tmp_path / "pipe.onnx")
    with pytest.raises(InputError, match="no such file"):
        opened(tmp_path / "pipe.onnx")
