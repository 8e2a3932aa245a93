"""Pool of subprocesses that run a network."""

from __future__ import annotations

import contextlib
import json
import tempfile
import threading
import weakref
from collections.abc import Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.codes import FILE_PATH_INVALID
from scanloom.stages.files.subprocess_reader import start_reader_subprocess
from scanloom.stages.stereo.codes import DEPTH_NETWORK_UNUSABLE

Map = NDArray[np.float32]

# Maximum length of a JSON message in bytes; messages have only metadata or an error.
_MAX_LINE_BYTES = 1 << 20


class NetworkProcesses:
    """Network file with a pool of processes, one per concurrent call.

    Attributes
    ----------
    file : network file.
    inputs, outputs : as the network declares them: `name`, `shape` (None for a free dimension) and `type`.
    """

    def __init__(self, file: Path, memory: int, seconds: float) -> None:
        """Start the first process, which loads the network.

        Parameters
        ----------
        memory : additional memory limit per process, bytes, where the operating system has limits.
        seconds : time limit for loading, and for each run.

        Raises
        ------
        InputError
            If the network cannot be run.
        UsageError
            If onnxruntime is not installed.
        """
        if find_spec("onnxruntime") is None:
            raise UsageError(
                DEPTH_NETWORK_UNUSABLE,
                "onnxruntime is required to run networks",
                remedy="install scanloom[network].",
                where=file,
            )
        if not file.is_file():
            raise InputError(FILE_PATH_INVALID, "there is no such file.", file)
        self.file = file
        # Working directory of the processes. It stays empty, so that a network cannot load other files from
        # it.
        folder = tempfile.TemporaryDirectory(prefix="scanloom-")
        self._start = partial(_Process, file, folder.name, memory, seconds)
        self._idle: list[_Process] = []
        self._lock = threading.Lock()
        self._end = weakref.finalize(self, _stop_all, self._idle, folder)
        first = self._start()
        self.inputs: Sequence[Mapping[str, Any]] = first.description["inputs"]
        self.outputs: Sequence[Mapping[str, Any]] = first.description["outputs"]
        self._idle.append(first)

    def run(self, feeds: Mapping[str, NDArray[Any]], outputs: Sequence[str]) -> list[Map]:
        """Run the network and return the requested outputs as float32.

        Thread-safe: concurrent calls run in separate processes.

        Parameters
        ----------
        feeds : input arrays by input name.
        outputs : names of the outputs.

        Raises
        ------
        InputError
            If the network cannot be run on the inputs, or exceeds its time or memory limit.
        """
        with self._lock:
            process = self._idle.pop() if self._idle else None
        process = process or self._start()
        try:
            found = process.run(feeds, outputs)
        except BaseException:
            process.end()
            raise
        with self._lock:
            self._idle.append(process)
        return found

    def close(self) -> None:
        """Kill the processes."""
        self._end()


def _stop_all(processes: list[_Process], folder: tempfile.TemporaryDirectory[str]) -> None:
    while processes:
        processes.pop().end()
    folder.cleanup()


class _Process:
    def __init__(self, file: Path, folder: str, memory: int, seconds: float) -> None:
        self._file, self._seconds = file, seconds
        words = [str(file.resolve()), folder, str(memory), str(seconds)]
        self._child = start_reader_subprocess("scanloom.stages.stereo.networks.worker", words)
        try:
            self.description = self._send_request(b"", ())[0]
        except BaseException:
            self.end()
            raise

    def run(self, feeds: Mapping[str, NDArray[Any]], outputs: Sequence[str]) -> list[Map]:
        arrays = [np.ascontiguousarray(one) for one in feeds.values()]
        told = [
            {"name": name, "type": one.dtype.str, "shape": one.shape}
            for name, one in zip(feeds, arrays, strict=True)
        ]
        line = json.dumps({"feeds": told, "outputs": list(outputs)}).encode() + b"\n"
        _, found = self._send_request(line, arrays)
        return found

    def end(self) -> None:
        self._child.kill()
        for pipe in (self._child.stdin, self._child.stdout):
            if pipe is not None:
                with contextlib.suppress(OSError):  # unread data in the pipe
                    pipe.close()
        self._child.wait()

    def _send_request(self, line: bytes, arrays: Sequence[NDArray[Any]]) -> tuple[dict[str, Any], list[Map]]:
        """Send a request, and return the reply with its arrays.

        Kills the process at the time limit.
        """
        is_late = threading.Event()

        def stop() -> None:
            is_late.set()
            self._child.kill()

        timer = threading.Timer(self._seconds, stop)
        timer.daemon = True
        timer.start()
        requests, answers = self._child.stdin, self._child.stdout
        assert requests is not None
        assert answers is not None
        try:
            requests.write(line)
            for array in arrays:
                requests.write(array.data)
            requests.flush()
            reply: dict[str, Any] = json.loads(answers.readline(_MAX_LINE_BYTES))
            found = [_read_array(answers, shape) for shape in reply.get("shapes", ())]
        except (OSError, ValueError) as error:
            reason = (
                f"it exceeds the time limit of {self._seconds:g} s (depth.model_seconds)"
                if is_late.is_set()
                else "it crashed, or exceeds the memory limit (depth.model_memory)"
            )
            raise InputError(
                DEPTH_NETWORK_UNUSABLE, "cannot be run as a network: {why}.", self._file, why=reason
            ) from error
        finally:
            timer.cancel()
        if "error" in reply:
            raise InputError(
                DEPTH_NETWORK_UNUSABLE, "cannot be run as a network: {said}.", self._file, said=reply["error"]
            )
        return reply, found


def _read_array(answers: Any, shape: Sequence[int]) -> Map:
    count = int(np.prod(shape, dtype=np.int64))
    data = answers.read(4 * count)
    if len(data) != 4 * count:
        raise ValueError("cut short")
    return np.frombuffer(data, "<f4").reshape(shape)
