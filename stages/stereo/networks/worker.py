"""Subprocess that runs a network, controlled by `scanloom.stages.stereo.networks.process_pool`.

onnxruntime loads untrusted files. The subprocess contains crashes, endless loops and excessive memory use.
"""

from __future__ import annotations

import json
import math
import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.subprocess_reader import limit_memory
from scanloom.stages.stereo.codes import DEPTH_NETWORK_UNUSABLE

# Seconds after the time limit at which the subprocess ends itself; the parent process has killed it before
# then.
_GRACE_SECONDS = 5
# Size limit of a protobuf file.
_MAX_FILE_BYTES = (1 << 31) - 1
# Maximum number of output values per input value; some networks return flow, or several pyramid levels.
_MAX_VALUES_PER_PIXEL = 16
# Parts of error messages of onnxruntime and C++ about insufficient memory.
_MEMORY_ERROR_TEXTS = ("bad_alloc", "bad allocation", "BFCArena", "Failed to allocate memory")
TENSOR_TYPES = {
    "tensor(float)": "<f4",
    "tensor(float16)": "<f2",
    "tensor(uint8)": "|u1",
    "tensor(double)": "<f8",
}


def main() -> None:
    """Load a network, and run it on requests until the input ends.

    Command line arguments: network file, empty folder, memory limit in bytes, time limit in seconds.
    """
    # Output printed by libraries goes to stderr, so that it cannot corrupt the replies.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    path, folder, memory, seconds = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), float(sys.argv[4])
    # External weight files are resolved against the working directory, which is empty.
    os.chdir(folder)
    try:
        limit_memory(memory)
        with _limit_time(seconds):
            session = _load_session(path)
    except BaseException as error:
        _send_reply(answers, {"error": _format_error(error)})
        return
    _send_reply(answers, _describe_session(session))
    _serve(session, sys.stdin.buffer, answers, seconds)


@contextmanager
def _limit_time(seconds: float) -> Iterator[None]:
    """End this process after a time limit.

    This is for the case that the parent process is gone. The limit is a few seconds longer than the parent's
    own.
    """
    # Windows has no signal.alarm.
    alarm: Callable[[int], int] | None = getattr(signal, "alarm", None)
    if alarm is None:
        yield
        return
    alarm(math.ceil(seconds) + _GRACE_SECONDS)
    try:
        yield
    finally:
        alarm(0)


def _load_session(path: Path) -> Any:
    import onnxruntime

    if path.stat().st_size > _MAX_FILE_BYTES:
        raise InputError(DEPTH_NETWORK_UNUSABLE, "the file is larger than 2 GB, the limit of ONNX files")
    options = onnxruntime.SessionOptions()
    # One thread keeps the order of summation, and with it the result, fixed. Several pairs use several
    # processes.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.use_deterministic_compute = True
    options.log_severity_level = 4
    return onnxruntime.InferenceSession(read_input_bytes(path), options, providers=["CPUExecutionProvider"])


def _describe_session(session: Any) -> dict[str, Any]:
    def describe_value(one: Any) -> dict[str, Any]:
        shape = [size if isinstance(size, int) and size > 0 else None for size in one.shape or ()]
        return {"name": one.name, "shape": shape, "type": one.type}

    return {
        "inputs": [describe_value(one) for one in session.get_inputs()],
        "outputs": [describe_value(one) for one in session.get_outputs()],
    }


def _serve(session: Any, questions: BinaryIO, answers: BinaryIO, seconds: float) -> None:
    while line := questions.readline():
        asked = json.loads(line)
        feeds = {one["name"]: _read_array(questions, one["type"], one["shape"]) for one in asked["feeds"]}
        pixels = max(feed.size for feed in feeds.values())
        try:
            with _limit_time(seconds):
                outputs = [_to_float_array(one, pixels) for one in session.run(asked["outputs"], feeds)]
        except BaseException as error:
            _send_reply(answers, {"error": _format_error(error)})
            continue
        _send_reply(answers, {"shapes": [one.shape for one in outputs]}, *outputs)


def _to_float_array(output: Any, pixels: int) -> NDArray[np.float32]:
    array = np.asarray(output)
    if array.dtype.kind not in "fiu":
        raise InputError(
            DEPTH_NETWORK_UNUSABLE,
            "an output has type {array_dtype} instead of numbers",
            array_dtype=array.dtype,
        )
    if array.size > _MAX_VALUES_PER_PIXEL * pixels:
        raise InputError(
            DEPTH_NETWORK_UNUSABLE,
            "an output has {array_size:,} values for an input of {pixels:,}, more than a map can have",
            array_size=array.size,
            pixels=pixels,
        )
    with np.errstate(over="ignore"):
        return np.ascontiguousarray(array, "<f4")


def _read_array(questions: BinaryIO, kind: str, shape: list[int]) -> NDArray[Any]:
    size = np.dtype(kind).itemsize * int(np.prod(shape))
    return np.frombuffer(questions.read(size), kind).reshape(shape)


def _send_reply(answers: BinaryIO, told: dict[str, Any], *arrays: NDArray[np.float32]) -> None:
    answers.write(json.dumps(told).encode() + b"\n")
    for array in arrays:
        answers.write(array.tobytes())
    answers.flush()


def _format_error(error: BaseException) -> str:
    """Return the error as a short message of one line."""
    if isinstance(error, InputError):
        return str(error)
    text = " ".join(str(error).split())
    if isinstance(error, MemoryError) or any(word in text for word in _MEMORY_ERROR_TEXTS):
        return "it exceeds the memory limit (depth.model_memory)"
    if "External data" in text or "external data" in text:
        return (
            "it stores its weights in other files, which are not read; merge them into one file with "
            "onnx.save(onnx.load(FILE), OTHER)"
        )
    # Format of onnxruntime: "[ONNXRuntimeError] : 2 : INVALID_ARGUMENT : message".
    said = text.split(" : ", 3)[-1] if text.startswith("[ONNX") else text
    return f"onnxruntime reports: {said[:200].rstrip('. ')}"
