"""Reading the weights of a PyTorch checkpoint without PyTorch.

A checkpoint is a zip archive with a pickle of the names and shapes, and one file for each array. A pickle can
run any program, so only arrays and dictionaries are accepted.
"""

from __future__ import annotations

import io
import pickle
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_DAMAGED
from scanloom.stages.files.zip_archives import open_archive, read_entry

Weights = dict[str, NDArray[np.float32]]

_TYPES = {"FloatStorage": "<f4", "LongStorage": "<i8"}
# Maximum size of an unpacked entry.
_MAX_BYTES = 1 << 26


@dataclass(frozen=True)
class _Storage:
    dtype: str
    name: str


def read_checkpoint(path: Path) -> Weights:
    """Read the arrays of a checkpoint by name.

    Raises
    ------
    InputError
        If the file is no checkpoint of arrays.
    """
    with open_archive(path) as archive:
        names = (one for one in archive.namelist() if one.endswith("/data.pkl"))
        index = next(names, "data.pkl")

        def read(name: str) -> bytes:
            return read_entry(archive, f"{index.removesuffix('data.pkl')}{name}", path, _MAX_BYTES)

        try:
            found = _ArrayUnpickler(read("data.pkl"), lambda name: read(f"data/{name}")).load()
            return {str(name): np.asarray(array, np.float32) for name, array in dict(found).items()}
        except InputError:
            raise
        # Damaged pickles raise nearly anything.
        except Exception as error:
            raise InputError(
                FILE_DAMAGED, "this is no checkpoint of arrays ({detail}).", path, detail=error
            ) from error


class _ArrayUnpickler(pickle.Unpickler):
    """Unpickler of arrays in dictionaries."""

    def __init__(self, index: bytes, read: Callable[[str], bytes]) -> None:
        super().__init__(io.BytesIO(index))
        self._read = read

    def find_class(self, module: str, name: str) -> Any:
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return self._build_array
        if (module, name) == ("collections", "OrderedDict"):
            return OrderedDict
        if module == "torch" and name in _TYPES:
            return name
        raise pickle.UnpicklingError(f"{module}.{name} is no array")

    def persistent_load(self, identity: Any) -> _Storage:
        kind, type_name, name, *_ = identity
        if kind != "storage":
            raise pickle.UnpicklingError(f"{kind} is no array")
        return _Storage(_TYPES[type_name], str(name))

    def _build_array(
        self, storage: _Storage, offset: int, shape: Sequence[int], strides: Sequence[int], *_: object
    ) -> NDArray[Any]:
        values = np.frombuffer(self._read(storage.name), storage.dtype)
        last = offset + sum((size - 1) * stride for size, stride in zip(shape, strides, strict=True))
        if min((offset, *strides)) < 0 or last >= len(values):
            raise pickle.UnpicklingError("an array is larger than its values")
        bytes_of = [stride * values.itemsize for stride in strides]
        view: NDArray[Any] = np.lib.stride_tricks.as_strided(
            values[offset:], shape, bytes_of, writeable=False
        )
        return np.array(view)
