"""Untrusted network files run or give a one-sentence error; none crashes or hangs the program."""

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


def open_processes(file: Path, memory: int = 3 << 30, seconds: float = 60) -> NetworkProcesses:
    return NetworkProcesses(file, memory, seconds)


def get_error(file: Path, **limits: float) -> str:
    """Get the error message of a file that cannot be loaded or run."""
    with pytest.raises(InputError) as caught:
        open_processes(file, **limits).run(FEED, ["depth"])
    said = str(caught.value)
    assert said.startswith(f"{file}: cannot be run as a network: ")
    assert "\n" not in said
    assert len(said) < 500
    return said


def write_graph(file: Path, *nodes: onnx.NodeProto, weights=(), output=None) -> Path:
    return onnx_networks.save_network(file, nodes, [IMAGE], [("depth", output)], weights)


def test_a_network_lists_its_inputs_and_runs_repeatedly(tmp_path):
    one = open_processes(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))
    assert one.inputs == [{"name": "image", "shape": [1, 3, None, None], "type": "tensor(float)"}]
    assert [told["name"] for told in one.outputs] == ["depth"]
    for size in ((4, 5), (30, 7)):
        image = np.random.default_rng(1).random((1, 3, *size), np.float32)
        (found,) = one.run({"image": image}, ["depth"])
        np.testing.assert_allclose(found[0, 0], 5 + 2 * image[0].mean(axis=0), rtol=1e-5)


def test_concurrent_runs_agree(tmp_path):
    one = open_processes(onnx_networks.write_stereo_network(tmp_path / "net.onnx"))
    pair = np.random.default_rng(1).random((2, 1, 3, 40, 60), np.float32) * 255
    feeds = {"left": pair[0], "right": pair[1]}
    alone = one.run(feeds, ["disparity"])[0]
    with ThreadPoolExecutor(3) as threads:
        for (found,) in threads.map(lambda _: one.run(feeds, ["disparity"]), range(6)):
            assert found.tobytes() == alone.tobytes()


def test_processes_end_with_their_owner(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    one = open_processes(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))
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
        get_error(file)


def test_weights_in_other_files_are_not_read(tmp_path):
    (tmp_path / "weights").write_bytes(np.float32(2).tobytes())
    file = write_graph(
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
        assert "weights in other files" in get_error(other)


def test_a_network_with_excessive_memory(tmp_path):
    size = helper.make_tensor("v", TensorProto.INT64, [2], [200_000, 200_000])
    file = write_graph(
        tmp_path / "net.onnx",
        helper.make_node("Constant", [], ["size"], value=size),
        helper.make_node("ConstantOfShape", ["size"], ["all"]),
        helper.make_node("ReduceMean", ["all"], ["mean"]),
        helper.make_node("Add", ["image", "mean"], ["depth"]),
    )
    assert "exceeds the memory limit (depth.model_memory)" in get_error(file)


def test_a_network_that_never_ends(tmp_path, monkeypatch):
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
    file = write_graph(tmp_path / "net.onnx", forever, weights={"yes": np.array(True)})
    started = time.monotonic()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    assert "exceeds the time limit of 2 s (depth.model_seconds)" in get_error(file, seconds=2)
    assert time.monotonic() - started < 10
    gc.collect()
    assert [path.name for path in tmp_path.iterdir()] == ["net.onnx"]


def test_outputs_that_are_not_numeric_maps(tmp_path):
    wide = helper.make_node("Tile", ["image", "times"], ["depth"])
    file = write_graph(tmp_path / "net.onnx", wide, weights={"times": np.array([1, 1, 10, 10], np.int64)})
    assert "values for" in get_error(file)
    truth = write_graph(tmp_path / "truth.onnx", helper.make_node("IsNaN", ["image"], ["told"]))
    model = onnx.load(truth)
    model.graph.output[0].name, model.graph.output[0].type.tensor_type.elem_type = "told", TensorProto.BOOL
    truth.write_bytes(model.SerializeToString())
    with pytest.raises(InputError, match="type bool"):
        open_processes(truth).run(FEED, ["told"])


def test_without_onnxruntime_the_error_names_the_extra(tmp_path, monkeypatch):
    monkeypatch.setattr(process_pool, "find_spec", {}.get)
    with pytest.raises(UsageError, match=r"install scanloom\[network\]"):
        open_processes(onnx_networks.write_brightness_network(tmp_path / "net.onnx"))


def test_missing_files_folders_and_pipes(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        open_processes(tmp_path / "none.onnx")
    with pytest.raises(InputError, match="no such file"):
        open_processes(tmp_path)
    os.mkfifo(tmp_path / "pipe.onnx")
    with pytest.raises(InputError, match="no such file"):
        open_processes(tmp_path / "pipe.onnx")
