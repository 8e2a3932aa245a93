"""Small ONNX networks: a stereo block matcher, and monocular depth from brightness."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

_OPSET = 17


def save_network(path: Path, nodes: Sequence[onnx.NodeProto], inputs, outputs, weights=()) -> Path:
    """Save a network with inputs and outputs as (name, shape[, type]) and weights by name."""

    def make_value_info(name, shape, kind=TensorProto.FLOAT):
        return helper.make_tensor_value_info(name, kind, shape)

    graph = helper.make_graph(
        list(nodes),
        "made",
        [make_value_info(*one) for one in inputs],
        [make_value_info(*one) for one in outputs],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in dict(weights).items()],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", _OPSET)], ir_version=8)
    path.write_bytes(model.SerializeToString())
    return path


def write_stereo_network(
    path: Path,
    *,
    disparities: int = 32,
    scale: float = 1.0,
    size: tuple[int | str, int | str] = ("height", "width"),
    names: tuple[str, str] = ("left", "right"),
    swapped: bool = False,
    low: float = 0.0,
    high: float = 255.0,
    window: int = 7,
    sharpness: float = 0.6,
) -> Path:
    """Write a stereo network: grey, shift, difference, window mean, soft argmin.

    Parameters
    ----------
    scale : factor for the disparity output; −1 for networks with the opposite sign.
    low, high : input values of black and white; values beyond them are clipped, like saturated pixels.
    """
    shape = [1, 3, *size]
    # Shifting to the right by each disparity is a convolution with one-hot rows.
    shifts = np.eye(disparities, dtype=np.float32)[::-1].reshape(disparities, 1, 1, disparities)
    weights = {
        "low": np.float32(low),
        "high": np.float32(high),
        "to_grey": np.full((1, 3, 1, 1), 255 / 3 / (high - low), np.float32),
        "shifts": np.ascontiguousarray(shifts),
        "sharpness": np.float32(-sharpness),
        "steps": (scale * np.arange(disparities, dtype=np.float32)).reshape(1, -1, 1, 1),
        "axis": np.array([1], np.int64),
    }
    first, second = names[::-1] if swapped else names
    half = window // 2
    nodes = [
        helper.make_node("Clip", [first, "low", "high"], ["cut"]),
        helper.make_node("Clip", [second, "low", "high"], ["other_cut"]),
        helper.make_node("Conv", ["cut", "to_grey"], ["grey"]),
        helper.make_node("Conv", ["other_cut", "to_grey"], ["other"]),
        helper.make_node("Conv", ["other", "shifts"], ["shifted"], pads=[0, disparities - 1, 0, 0]),
        helper.make_node("Sub", ["grey", "shifted"], ["difference"]),
        helper.make_node("Abs", ["difference"], ["cost"]),
        helper.make_node("AveragePool", ["cost"], ["mean"], kernel_shape=[window] * 2, pads=[half] * 4),
        helper.make_node("Mul", ["mean", "sharpness"], ["logits"]),
        helper.make_node("Softmax", ["logits"], ["share"], axis=1),
        helper.make_node("Mul", ["share", "steps"], ["weighed"]),
        helper.make_node("ReduceSum", ["weighed", "axis"], ["disparity"], keepdims=1),
    ]
    inputs = [(name, shape) for name in names]
    return save_network(path, nodes, inputs, [("disparity", [1, 1, *size])], weights)


def write_brightness_network(path: Path, *, scale: float = 2.0, shift: float = 5.0) -> Path:
    """Write a monocular network: inverse depth is linear in the mean of the image's channels (0 to 1)."""
    weights = {
        "to_grey": np.full((1, 3, 1, 1), scale / 3, np.float32),
        "shift": np.array([shift], np.float32),
    }
    nodes = [helper.make_node("Conv", ["image", "to_grey", "shift"], ["depth"])]
    return save_network(path, nodes, [("image", [1, 3, "h", "w"])], [("depth", [1, 1, "h", "w"])], weights)
