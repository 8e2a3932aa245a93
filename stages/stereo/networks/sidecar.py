"""What a network's file does not say of itself: a page of TOML beside it, FILE.toml of FILE.onnx.

kind = "stereo"                       or "monocular"
color = "rgb"                         "bgr" or "grey"
range = [0, 255]                      what black and white are
mean = [0, 0, 0]                      taken away after that, in the order of `color`
std = [1, 1, 1]                       and divided by
layout = "nchw"                       or "nhwc"
multiple_of = 32                      what width and height must be multiples of, px
output = "disparity"                  the output that tells depth; of several channels the first
unit = "px"                           of a pair: "px" of disparity, "normalised" (disparity as a share of
                                      the width), "depth" or "inverse_depth" in metres; of one image
                                      "depth" or "inverse_depth" of unknown scale and shift
sign = 1                              −1 where the output is the negative
confidence = "certainty"              an output that is 0 to 1, 1 where it is sure; optional
occlusion = "hidden"                  an output that is 1 where the right image shows nothing; optional

[inputs]                              what each of the network's inputs takes
left = "left"                         "left", "right", both in one as "pair", or the one "image"; with
right = "right"                       "/2" behind it at half the size
"""

from __future__ import annotations

import difflib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from scanloom.stages.diagnostics.codes import USAGE_VALUE_INVALID
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.documents import read_document
from scanloom.stages.stereo.codes import DEPTH_NETWORK_SIDECAR_INVALID

STEREO, MONOCULAR = "stereo", "monocular"
PX, NORMALISED, DEPTH, INVERSE_DEPTH = "px", "normalised", "depth", "inverse_depth"

_TAKEN = {STEREO: ("left", "right", "pair"), MONOCULAR: ("image",)}
_UNITS = {STEREO: (PX, NORMALISED, DEPTH, INVERSE_DEPTH), MONOCULAR: (INVERSE_DEPTH, DEPTH)}
_WORDS = {
    "kind": (STEREO, MONOCULAR),
    "color": ("rgb", "bgr", "grey"),
    "layout": ("nchw", "nhwc"),
    "unit": _UNITS[STEREO],
}
_MOST_MULTIPLE = 1024
# The name of an input or output is no essay.
_LONGEST_NAME = 200
_LARGEST = 1e6


@dataclass(frozen=True)
class Sidecar:
    """What a network takes and gives; see the head of this file."""

    kind: str
    inputs: Mapping[str, str]
    output: str
    unit: str
    color: str = "rgb"
    range: tuple[float, float] = (0.0, 255.0)
    mean: tuple[float, float, float] = (0.0, 0.0, 0.0)
    std: tuple[float, float, float] = (1.0, 1.0, 1.0)
    layout: str = "nchw"
    multiple_of: int = 1
    sign: int = 1
    confidence: str | None = None
    occlusion: str | None = None
    # Of its own: where it was read from.
    file: Path | None = field(default=None, compare=False)

    def checked(self) -> Sidecar:
        """Return it, or raise InputError where its parts do not go together."""
        taken = [what.removesuffix("/2") for what in self.inputs.values()]
        allowed = _TAKEN[self.kind]
        for name, what in zip(self.inputs, taken, strict=True):
            if what not in allowed:
                raise InputError(
                    DEPTH_NETWORK_SIDECAR_INVALID,
                    "inputs.{name} is {what!r}; it must be one of {allowed}.",
                    name=name[:40],
                    what=what[:40],
                    allowed=", ".join(allowed),
                )
        if self.kind == STEREO and "pair" not in taken and {"left", "right"} - {*taken}:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID, "inputs must take both left and right, or a pair."
            )
        if self.unit not in _UNITS[self.kind]:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "unit is {unit!r}; of one image it must be {units}.",
                unit=self.unit,
                units=" or ".join(_UNITS[self.kind]),
            )
        if self.range[0] == self.range[1] or not all(one > 0 for one in self.std):
            raise InputError(DEPTH_NETWORK_SIDECAR_INVALID, "range must be of two values, and std above 0.")
        return self

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the outputs that are asked for, that of depth first."""
        return (self.output, *(name for name in (self.confidence, self.occlusion) if name is not None))

    @property
    def channels(self) -> int:
        """Return how many channels an image has as the network takes it."""
        return 1 if self.color == "grey" else 3


def sidecar_of(network: Path) -> Path:
    """Return where the sidecar of a network's file stands."""
    return network.with_suffix(".toml")


def read_sidecar(network: Path) -> Sidecar:
    """Read the sidecar beside a network's file.

    Raises
    ------
    InputError
        If there is none, it cannot be read, or it holds something else than what it may.
    """
    path = sidecar_of(network)
    if not path.is_file():
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            (
                "there is no {path_name} beside it, which says what it takes and gives; "
                "scanloom lab probe {network_name} --write guesses one."
            ),
            network,
            path_name=path.name,
            network_name=network.name,
        )
    values = read_document(path)
    known = [one.name for one in fields(Sidecar) if one.name != "file"]
    for name in values:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            advice = f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}."
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "there is no key {name!r}; {advice}",
                path,
                name=name[:40],
                advice=advice,
            )
    for name in ("kind", "inputs", "output", "unit"):
        if name not in values:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID, "it does not say {name}, which it must.", path, name=name
            )
    try:
        return Sidecar(**{name: _checked(name, value) for name, value in values.items()}, file=path).checked()
    except InputError as error:
        raise error.at(path) from None


def written(sidecar: Sidecar) -> str:
    """Return the TOML text that `read_sidecar` reads back to the same."""
    lines = []
    for one in fields(Sidecar):
        value = getattr(sidecar, one.name)
        if one.name not in ("inputs", "file") and value is not None:
            lines.append(f"{one.name} = {_toml(value)}")
    inputs = (f"{json.dumps(name)} = {json.dumps(taken)}" for name, taken in sidecar.inputs.items())
    return "\n".join([*lines, "", "[inputs]", *inputs, ""])


def _toml(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{number:g}' for number in value)}]"
    return json.dumps(value, ensure_ascii=False)


def _checked(name: str, value: Any) -> Any:
    """Return a value as the field has it, or raise InputError with what it must be."""
    if name in _WORDS:
        if value not in _WORDS[name]:
            raise InputError(
                USAGE_VALUE_INVALID,
                "{name} is {shown}; it must be one of {words}.",
                name=name,
                shown=_shown(value),
                words=", ".join(_WORDS[name]),
            )
        return value
    if name in ("output", "confidence", "occlusion"):
        return _name(name, value)
    if name == "range":
        return _numbers(name, value, 2)
    if name in ("mean", "std"):
        return _numbers(name, value, 3)
    if name == "sign":
        if value not in (1, -1) or isinstance(value, bool):
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID, "sign is {shown}; it must be 1 or -1.", shown=_shown(value)
            )
        return int(value)
    if name == "multiple_of":
        if type(value) is not int or not 1 <= value <= _MOST_MULTIPLE:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "multiple_of is {shown}; it must be from 1 to {most_multiple}.",
                shown=_shown(value),
                most_multiple=_MOST_MULTIPLE,
            )
        return value
    if not isinstance(value, dict) or not value:
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID, "inputs is no table of the network's inputs and what each takes."
        )
    return {_name("inputs", key): _name(f"inputs.{key[:40]}", taken) for key, taken in value.items()}


def _name(name: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= _LONGEST_NAME:
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            "{name} is {shown}; it must be a name.",
            name=name,
            shown=_shown(value),
        )
    return value


def _numbers(name: str, value: Any, count: int) -> tuple[float, ...]:
    good = isinstance(value, list) and len(value) == count
    if not good or not all(type(one) in (int, float) and abs(one) <= _LARGEST for one in value):
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            "{name} is {shown}; it must be {count} numbers.",
            name=name,
            shown=_shown(value),
            count=count,
        )
    return tuple(float(one) for one in value)


def _shown(value: Any) -> str:
    return repr(value)[:60]
