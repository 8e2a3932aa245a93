"""Guessing of a network's sidecar by running the network.

A stereo network runs with all common conventions on a synthetic pair of known disparity. The convention with
the lowest error wins. A monocular network has no known result. Its sidecar follows the usual conventions, and
is only checked for running.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError, StageError
from scanloom.stages.printing import format_by_metrics, render_table
from scanloom.stages.progress import Progress, ignore_progress
from scanloom.stages.stereo.codes import DEPTH_NETWORK_UNIDENTIFIED
from scanloom.stages.stereo.networks.network import Network
from scanloom.stages.stereo.networks.process_pool import NetworkProcesses
from scanloom.stages.stereo.networks.sidecar import INVERSE_DEPTH, MONOCULAR, NORMALISED, PX, STEREO, Sidecar

# Normalisation of ImageNet, RGB, for networks with pretrained encoders.
_IMAGENET = {"range": (0.0, 1.0), "mean": (0.485, 0.456, 0.406), "std": (0.229, 0.224, 0.225)}
# The most common first: it wins if several do equally well.
_NORMALISATIONS = (
    {"range": (0.0, 255.0)},
    {"range": (0.0, 1.0)},
    _IMAGENET,
    {"range": (-1.0, 1.0)},
)
_OUTPUT_CONVENTIONS = tuple(product((PX, NORMALISED), (1, -1)))
# Multiple of the image size, and test image size (height, width), for networks without a fixed size.
_SIZE_MULTIPLE = 32
_TEST_SIZE = (256, 384)
# Disparities of background and foreground of the test pair: image width divided by this.
_BACKGROUND_DIVISOR, _FOREGROUND_DIVISOR = 48, 19
# Maximum median error of a correct convention, px; conventions within this much of the best error are
# indistinguishable, px.
_MAX_ERROR_PX = 1.5
_INDISTINGUISHABLE_PX = 0.05
_CONFIDENCE_WORDS, _OCCLUSION_WORDS = ("conf", "certain"), ("occ", "hidden")
_DEPTH_WORDS = ("disp", "depth", "flow", "output")


@dataclass(frozen=True, eq=False)
class GuessedSidecar:
    """Guessed sidecar of a network.

    Attributes
    ----------
    sidecar : the guess.
    error_px : median disparity error on the test pair, px; None for a monocular network.
    alternatives : descriptions of other conventions that do equally well.
    """

    sidecar: Sidecar
    error_px: float | None
    alternatives: tuple[str, ...] = ()

    __repr__ = format_by_metrics
    _repr_html_ = render_table

    def to_dict(self) -> dict[str, Any]:
        """Return the guess, JSON-ready."""
        told = {name: value for name, value in vars(self.sidecar).items() if name != "file"}
        return {"sidecar": told, "error_px": self.error_px, "alike": list(self.alternatives)}


def probe_network(
    file: Path | str, *, memory: int = 8 << 30, seconds: float = 600, progress: Progress = ignore_progress
) -> GuessedSidecar:
    """Guess the sidecar of a network file.

    Parameters
    ----------
    file : ONNX file.
    memory, seconds : limits of the network process, bytes and seconds.
    progress : called after each convention that was tried.

    Raises
    ------
    InputError
        If the network cannot be run, or its inputs are neither an image nor a pair.
    StageError
        If no common convention reproduces the known disparity.
    UsageError
        If onnxruntime is not installed.
    """
    processes = NetworkProcesses(Path(file), memory, seconds)
    try:
        inputs, outputs = processes.inputs, processes.outputs
        kind, layout, ways = _list_input_roles(inputs, Path(file))
        named = _identify_outputs(outputs)
        base = Sidecar(
            kind, ways[0][0], named[0], PX, layout=layout, multiple_of=_guess_size_multiple(inputs, layout)
        )
        base = replace(base, confidence=named[1], occlusion=named[2])
        if kind == STEREO:
            return _probe_stereo(processes, [*_iterate_candidates(base, ways)], progress)
        return _probe_monocular(processes, base, ways[0][1])
    finally:
        processes.close()


def _probe_monocular(processes: NetworkProcesses, base: Sidecar, channels: int) -> GuessedSidecar:
    color = "grey" if channels == 1 else "rgb"
    numbers: dict[str, Any] = {"range": (0.0, 1.0)} if channels == 1 else _IMAGENET
    sidecar = replace(base, kind=MONOCULAR, unit=INVERSE_DEPTH, color=color, **numbers)
    left, _, _ = make_test_pair()
    found, _ = Network.from_processes(processes, sidecar).predict_image(left)
    if not np.isfinite(found).any():
        raise StageError(
            DEPTH_NETWORK_UNIDENTIFIED,
            "it returns no finite values for an image given as {said}.",
            where=processes.file,
            said=_describe_convention(sidecar),
        )
    return GuessedSidecar(sidecar, None)


def _probe_stereo(
    processes: NetworkProcesses, candidates: Sequence[Sidecar], progress: Progress
) -> GuessedSidecar:
    tried: list[tuple[float, Sidecar]] = []
    for done, sidecar in enumerate(candidates, 1):
        network = Network.from_processes(processes, sidecar)
        # At the fixed size of the network, so that images are not resampled.
        left, right, truth = make_test_pair(*network.fixed_size)
        given, _ = network.predict_left(left, right, 1.0, 0.0)
        for unit, sign in _OUTPUT_CONVENTIONS:
            scale = sign * (truth.shape[1] if unit == NORMALISED else 1)
            off = np.abs(given * np.float32(scale) - truth)[np.isfinite(truth)]
            error = float(np.median(np.where(np.isfinite(off), off, np.inf)))
            tried.append((error, replace(sidecar, unit=unit, sign=sign)))
        progress(done, len(candidates))
    least, nearest = min(tried, key=lambda one: one[0])
    if not least <= _MAX_ERROR_PX:
        raise StageError(
            DEPTH_NETWORK_UNIDENTIFIED,
            (
                "with none of the common conventions does it find the disparity of a test pair to "
                "{right:g} px; the best one, {said}, has an error of {least:.3g} px."
            ),
            remedy="Write its sidecar by hand.",
            where=processes.file,
            right=_MAX_ERROR_PX,
            said=_describe_convention(nearest),
            least=least,
        )
    good = [one for one in tried if one[0] <= least + _INDISTINGUISHABLE_PX]
    error, sidecar = good[0]
    return GuessedSidecar(
        sidecar, error, tuple(dict.fromkeys(_describe_convention(one) for _, one in good[1:]))
    )


def _iterate_candidates(base: Sidecar, ways: Sequence[tuple[dict[str, str], int]]) -> Iterator[Sidecar]:
    for inputs, channels in ways:
        for numbers in _NORMALISATIONS:
            for color in ("grey",) if channels == 1 else ("rgb", "bgr"):
                # Mean and deviation of ImageNet are in RGB order, so they are reversed for BGR.
                backwards = {
                    name: value[::-1] if color == "bgr" and len(value) == 3 else value
                    for name, value in numbers.items()
                }
                yield replace(base, inputs=inputs, color=color, **backwards)  # type: ignore[arg-type]


def make_test_pair(
    height: int | None = None, width: int | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.float32]]:
    """Create a synthetic pair: a rectangle in front of a background.

    Both have texture at several scales.

    Returns
    -------
    Left and right image, (h, w, 3) uint8 RGB, and the left disparity, (h, w) float32 px; NaN at the border
    and where occluded in the right image.
    """
    import cv2

    high, wide = height or _TEST_SIZE[0], width or _TEST_SIZE[1]
    far, near = wide // _BACKGROUND_DIVISOR, wide // _FOREGROUND_DIVISOR
    random = np.random.default_rng(7)

    def make_texture() -> NDArray[np.float32]:
        total = np.zeros((high, wide + far, 3), np.float32)
        for size in (2, 5, 12, 30):
            coarse = (high // size + 2, (wide + far) // size + 2, 3)
            noise = random.standard_normal(coarse).astype(np.float32)
            total += cv2.resize(noise, (wide + far, high), interpolation=cv2.INTER_CUBIC)
        # Channels differ in their mean, so that a wrong channel order or value range increases the error.
        return np.asarray(np.clip(np.array([140, 110, 80], np.float32) + 22 * total, 0, 255), np.float32)

    back, front = make_texture(), make_texture()
    rows, columns = slice(high // 4, 3 * high // 4), slice(wide // 3, 2 * wide // 3)
    left, right = back[:, :wide].copy(), back[:, far : wide + far].copy()
    left[rows, columns] = front[rows, columns]
    right[rows, columns.start - near : columns.stop - near] = front[rows, columns]
    truth = np.full((high, wide), far, np.float32)
    truth[rows, columns] = near
    truth[rows, columns.start - (near - far) : columns.start] = np.nan
    truth[:, : 2 * near] = truth[:, -near:] = np.nan
    return left.astype(np.uint8), right.astype(np.uint8), truth


def _list_input_roles(inputs: Sequence[Any], file: Path) -> tuple[str, str, list[tuple[dict[str, str], int]]]:
    """Derive the possible conventions from the input shapes.

    Returns
    -------
    kind : STEREO or MONOCULAR.
    layout : "nchw" or "nhwc".
    ways : candidates for the roles of the inputs, each with the number of channels of an image.
    """
    shapes = [[*one["shape"]] for one in inputs]
    is_last = bool(shapes) and all(
        len(one) >= 3 and one[-1] in (1, 3, 6) and one[-3] not in (1, 2, 3, 6) for one in shapes
    )
    counts = [None if len(one) < 3 else one[-1] if is_last else one[-3] for one in shapes]
    layout = "nhwc" if is_last else "nchw"
    names = [one["name"] for one in inputs]
    if len(names) == 1 and counts[0] in (2, 6):
        return STEREO, layout, [({names[0]: "pair"}, counts[0] // 2)]
    if len(names) == 1 and counts[0] in (None, 1, 3):
        return MONOCULAR, layout, [({names[0]: "image"}, counts[0] or 3)]
    if len(names) in (2, 4) and all(count in (None, 1, 3) for count in counts):
        # Networks with four inputs take the pair at half size first, usually named init_….
        half = ["/2" if len(names) == 4 and at < 2 else "" for at in range(len(names))]
        orders = (("left", "right"), ("right", "left"))
        ways = [
            (
                {name: side + small for name, side, small in zip(names, 2 * order, half, strict=False)},
                counts[0] or 3,
            )
            for order in orders
        ]
        # Inputs named left and right leave only one order.
        if "left" in names[0].lower() and "right" in names[1].lower():
            ways = ways[:1]
        return STEREO, layout, ways
    told = ", ".join(f"{one['name'][:40]} {one['shape']}" for one in inputs)
    raise InputError(
        DEPTH_NETWORK_UNIDENTIFIED,
        "its inputs ({told}) are neither an image nor a pair",
        file,
        remedy="write its sidecar by hand.",
        told=told[:200],
    )


def _identify_outputs(outputs: Sequence[Any]) -> tuple[str, str | None, str | None]:
    """Find the outputs for depth, confidence and occlusion by their names."""
    names = [one["name"] for one in outputs]

    def find_name(words: Sequence[str], among: Sequence[str]) -> str | None:
        return next((name for name in among if any(word in name.lower() for word in words)), None)

    sure, hidden = find_name(_CONFIDENCE_WORDS, names), find_name(_OCCLUSION_WORDS, names)
    others = [name for name in names if name not in (sure, hidden)] or names
    # Networks with iterative refinement return the final result last.
    return find_name(_DEPTH_WORDS, others) or others[-1], sure, hidden


def _guess_size_multiple(inputs: Sequence[Any], layout: str) -> int:
    sizes = [one["shape"][-2:] if layout == "nchw" else one["shape"][-3:-1] for one in inputs]
    return 1 if all(size is not None for pair in sizes for size in pair) else _SIZE_MULTIPLE


def _describe_convention(sidecar: Sidecar) -> str:
    low, high = sidecar.range
    takes = f"{sidecar.color} {low:g} to {high:g}" + (" minus a mean" if any(sidecar.mean) else "")
    order = "" if "pair" in sidecar.inputs.values() else f", {' and '.join(sidecar.inputs.values())}"
    sign = "−" if sidecar.sign < 0 else ""
    return f"{takes}{order}, {sign}{sidecar.unit}"
