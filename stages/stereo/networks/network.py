"""Inference of a user-supplied network, with pre- and postprocessing from its sidecar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.stereo.codes import DEPTH_NETWORK_SIDECAR_INVALID
from scanloom.stages.stereo.networks.process_pool import NetworkProcesses
from scanloom.stages.stereo.networks.sidecar import DEPTH, NORMALISED, PX, STEREO, Sidecar, read_sidecar
from scanloom.stages.stereo.networks.worker import TENSOR_TYPES

RESULT_VERSION = 1

Image = NDArray[np.uint8]
Map = NDArray[np.float32]

# Minimum size of an output map relative to the image, per side.
_MIN_SIZE_RATIO = 1 / 16
_HALF = "/2"


@dataclass(frozen=True)
class PairPrediction:
    """Output of a stereo network for a rectified pair.

    Attributes
    ----------
    left, right : (h, w) float32 px, disparity of each image (x of the left minus x of the right image). Not
        finite where the network gave no number. The right one comes from the mirrored pair.
    confidence : (h, w) float32, 0 to 1, confidence of the left disparity by the network; 1 if it has no such
        output.
    """

    left: Map
    right: Map
    confidence: Map


class Network:
    """Network file with its sidecar, ready to run.

    `fixed_size` is the required height and width, each None if any value is accepted. Results do not depend
    on the number of threads, on one machine type and one version of onnxruntime: each process has one thread,
    and several pairs run in several processes.

    Parameters
    ----------
    file : ONNX file; see scanloom.stages.stereo.networks.sidecar for its sidecar.
    memory, seconds : limits per process, bytes and seconds; see scanloom.stages.stereo.networks.process_pool.
    sidecar : replaces the sidecar next to the file.

    Raises
    ------
    InputError
        If the file is missing, cannot be run, or does not match its sidecar.
    UsageError
        If onnxruntime is not installed.
    """

    def __init__(self, file: Path, memory: int, seconds: float, sidecar: Sidecar | None = None) -> None:
        sidecar = sidecar or (read_sidecar(file) if file.is_file() else None)
        processes = NetworkProcesses(file, memory, seconds)
        assert sidecar is not None  # NetworkProcesses raises if the file is missing
        self._initialise(file, sidecar, processes)

    @classmethod
    def from_processes(cls, processes: NetworkProcesses, sidecar: Sidecar) -> Network:
        """Create a network whose processes are already running."""
        network = cls.__new__(cls)
        network._initialise(processes.file, sidecar, processes)
        return network

    def _initialise(self, file: Path, sidecar: Sidecar, processes: NetworkProcesses) -> None:
        self.file, self.sidecar, self._processes = file, sidecar, processes
        _check_outputs(sidecar, processes)
        self._inputs = {one["name"]: one for one in processes.inputs}
        missing = next((name for name in self._inputs if name not in sidecar.inputs), None)
        odd = next((name for name in sidecar.inputs if name not in self._inputs), missing)
        if odd is not None:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "the sidecar names the inputs {inputs}, but the network has {detail}.",
                sidecar.file or file,
                detail=", ".join(self._inputs)[:200] or "none",
                inputs=", ".join(sidecar.inputs)[:200],
            )
        self.fixed_size = self._derive_fixed_size()

    @property
    def is_stereo(self) -> bool:
        """Return True if the network takes pairs instead of single images."""
        return self.sidecar.kind == STEREO

    def predict_pair(self, left: Image, right: Image, focal_baseline: float, offset: float) -> PairPrediction:
        """Compute the disparities of both images of a rectified pair.

        Parameters
        ----------
        left, right : (h, w, 3) RGB or (h, w) grey uint8.
        focal_baseline, offset : px · m and px: depth is focal_baseline / (disparity + offset).

        Raises
        ------
        InputError
            If the network cannot be run, or its output is not a map of the image.
        """
        of_left, sure = self.predict_left(left, right, focal_baseline, offset)
        mirrored, _ = self.predict_left(_mirror(right), _mirror(left), focal_baseline, offset)
        return PairPrediction(of_left, _mirror(mirrored), sure)

    def predict_left(
        self, left: Image, right: Image, focal_baseline: float, offset: float
    ) -> tuple[Map, Map]:
        """Compute the left disparity and its confidence; see `predict_pair`."""
        depth, *rest = self._run_on_images({"left": left, "right": right})
        return self._convert_to_pixels(depth, focal_baseline, offset), self._combine_confidence(
            rest, depth.shape
        )

    def predict_image(self, image: Image) -> tuple[Map, Map]:
        """Run a monocular network on an image and on its mirror image.

        Returns
        -------
        Two maps (h, w) float32, the second one mirrored back, in the unit of the sidecar. Larger values are
        farther for depth, and nearer for inverse depth.

        Raises
        ------
        InputError
            As `predict_pair`.
        """
        first, second = (self._run_on_images({"image": one})[0] for one in (image, _mirror(image)))
        return first, _mirror(second)

    def _convert_to_pixels(self, depth: Map, focal_baseline: float, offset: float) -> Map:
        unit = self.sidecar.unit
        if unit == PX:
            return depth
        if unit == NORMALISED:
            return np.asarray(depth * np.float32(depth.shape[1]), np.float32)
        with np.errstate(all="ignore"):
            inverse = 1 / depth if unit == DEPTH else depth
            return np.asarray(np.float32(focal_baseline) * inverse - np.float32(offset), np.float32)

    def _combine_confidence(self, outputs: Sequence[Map], shape: tuple[int, ...]) -> Map:
        """Combine confidence and occlusion outputs to a confidence from 0 to 1."""
        sure = np.ones(shape, np.float32)
        for name, one in zip(self.sidecar.outputs[1:], outputs, strict=True):
            known = np.clip(np.nan_to_num(one, nan=1.0 if name == self.sidecar.occlusion else 0.0), 0, 1)
            sure *= 1 - known if name == self.sidecar.occlusion else known
        return sure

    def _run_on_images(self, images: Mapping[str, Image]) -> list[Map]:
        """Run the network and return its outputs at image size."""
        import cv2

        height, width = next(iter(images.values())).shape[:2]
        wide, high = self.fixed_size[1] or width, self.fixed_size[0] or height
        multiple = self.sidecar.multiple_of
        right, below = (
            0 if fixed else -size % multiple
            for size, fixed in zip((width, height), self.fixed_size[::-1], strict=True)
        )
        padded = {
            name: np.asarray(
                cv2.copyMakeBorder(_resize(one, wide, high), 0, below, 0, right, cv2.BORDER_REPLICATE),
                np.uint8,
            )
            for name, one in images.items()
        }
        feeds = {name: self._build_tensor(padded, name, taken) for name, taken in self.sidecar.inputs.items()}
        found = self._processes.run(feeds, self.sidecar.outputs)
        maps = [
            self._extract_map(one, name, (high + below, wide + right))[:high, :wide]
            for name, one in zip(self.sidecar.outputs, found, strict=True)
        ]
        if not np.isfinite(maps[0]).any():
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "its output {output} has no finite values.",
                self.file,
                output=self.sidecar.output[:40],
            )
        # Disparity in pixels scales with the image width.
        scale = self.sidecar.sign * (width / wide if self.sidecar.unit == PX else 1)
        with np.errstate(over="ignore", invalid="ignore"):
            maps[0] = maps[0] * np.float32(scale)
        return [_resize(one, width, height) for one in maps]

    def _build_tensor(self, images: Mapping[str, Image], name: str, role: str) -> NDArray[Any]:
        """Build the tensor of a network input.

        Parameters
        ----------
        images : padded images by role: left, right or image.
        name : name of the input.
        role : role of the input in the sidecar, such as "pair" or "left/2".
        """
        import cv2

        is_half = role.endswith(_HALF)
        what = role.removesuffix(_HALF)
        planes = [
            self._normalise_image(images[one]) for one in (("left", "right") if what == "pair" else (what,))
        ]
        values: NDArray[Any] = np.concatenate(planes, axis=2)
        if is_half:
            size = (values.shape[1] // 2, values.shape[0] // 2)
            smaller = cv2.resize(values, size, interpolation=cv2.INTER_AREA)
            values = np.asarray(smaller, np.float32).reshape(*size[::-1], -1)
        if self.sidecar.layout == "nchw":
            values = values.transpose(2, 0, 1)
        about = self._inputs[name]
        kind = np.dtype(TENSOR_TYPES[about["type"]])
        if kind.kind == "u":
            values = np.clip(np.rint(values), 0, 255)
        leading = max(len(about["shape"]) - 3, 0) if about["shape"] else 1
        return values.astype(kind).reshape(*leading * (1,), *values.shape)

    def _normalise_image(self, image: Image) -> Map:
        """Normalise an image as the sidecar states.

        Returns
        -------
        (h, w, channels) float32.
        """
        import cv2

        colors = image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2RGB)
        if self.sidecar.color == "grey":
            colors = cv2.cvtColor(colors, cv2.COLOR_RGB2GRAY)[..., None]
        elif self.sidecar.color == "bgr":
            colors = colors[..., ::-1]
        low, high = self.sidecar.range
        mean, std = (
            np.array(one[: colors.shape[2]], np.float32) for one in (self.sidecar.mean, self.sidecar.std)
        )
        values = np.float32(low) + colors.astype(np.float32) * np.float32((high - low) / 255)
        return np.asarray((values - mean) / std, np.float32)

    def _extract_map(self, output: Map, name: str, size: tuple[int, int]) -> Map:
        """Return an output as a map (h, w).

        Parameters
        ----------
        size : height and width of the network input, to which the output is resized.

        Raises
        ------
        InputError
            If the output is not a map of the input.
        """
        plane = output
        while plane.ndim > 2 and plane.shape[0] == 1:
            plane = plane[0]
        if plane.ndim == 3:
            plane = plane[0] if self.sidecar.layout == "nchw" else plane[..., 0]
        if (
            plane.ndim != 2
            or min(np.divide(plane.shape, size)) < _MIN_SIZE_RATIO
            or max(np.divide(plane.shape, size)) > 1
        ):
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                (
                    "its output {name} has shape {shape} for an image of {size} × {size_2} px, so it is not "
                    "a map of the image."
                ),
                self.file,
                name=name[:40],
                shape=_format_shape(output.shape),
                size=size[1],
                size_2=size[0],
            )
        return _resize(plane, size[1], size[0])

    def _derive_fixed_size(self) -> tuple[int | None, int | None]:
        """Return the fixed height and width of the inputs, None where any."""
        heights, widths = set(), set()
        for name, taken in self.sidecar.inputs.items():
            about = self._inputs[name]
            if about["type"] not in TENSOR_TYPES:
                raise InputError(
                    DEPTH_NETWORK_SIDECAR_INVALID,
                    "its input {name} has type {about}; supported are {types}.",
                    self.file,
                    name=name[:40],
                    about=about["type"],
                    types=", ".join(TENSOR_TYPES),
                )
            shape = about["shape"]
            if not shape:
                continue
            *leading, a, b, c = shape if len(shape) >= 3 else (2, None, None, None)
            channels, height, width = (a, b, c) if self.sidecar.layout == "nchw" else (c, a, b)
            wanted = self.sidecar.channels * (2 if taken.startswith("pair") else 1)
            if channels not in (None, wanted) or any(one not in (None, 1) for one in leading):
                raise InputError(
                    DEPTH_NETWORK_SIDECAR_INVALID,
                    (
                        "its input {name} has shape {shape}, but {taken} in {color}, {layout}, as the "
                        "sidecar states, has {wanted} channels."
                    ),
                    self.file,
                    name=name[:40],
                    shape=_format_shape(shape),
                    taken=taken,
                    color=self.sidecar.color,
                    layout=self.sidecar.layout,
                    wanted=wanted,
                )
            times = 2 if taken.endswith(_HALF) else 1
            heights.add(height and height * times)
            widths.add(width and width * times)
        sizes = [{one for one in found if one is not None} for found in (heights, widths)]
        if any(len(one) > 1 for one in sizes):
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID, "its inputs have different fixed sizes.", self.file
            )
        found = [next(iter(one), None) for one in sizes]
        return found[0], found[1]


def _check_outputs(sidecar: Sidecar, processes: NetworkProcesses) -> None:
    there = [one["name"] for one in processes.outputs]
    for name in sidecar.outputs:
        if name not in there:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "the network has no output {name!r}, only {there}.",
                sidecar.file or processes.file,
                name=name[:40],
                there=", ".join(there)[:200],
            )


def _mirror(image: NDArray[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(image[:, ::-1])


def _resize(image: NDArray[Any], width: int, height: int) -> NDArray[Any]:
    import cv2

    if image.shape[:2] == (height, width):
        return image
    shrinks = width * height < image.shape[0] * image.shape[1]
    method = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return np.asarray(cv2.resize(np.ascontiguousarray(image), (width, height), interpolation=method))


def _format_shape(shape: Sequence[int | None]) -> str:
    return " × ".join("?" if one is None else str(one) for one in shape) or "nothing"
