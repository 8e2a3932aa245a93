"""Sidecar of a network file.

FILE.toml states the conventions that FILE.onnx does not store:

kind = "stereo"                       or "monocular"
color = "rgb"                         "bgr" or "grey"
range = [0, 255]                      values of black and white
mean = [0, 0, 0]                      subtracted afterwards, in the order of `color`
std = [1, 1, 1]                       divisor after the subtraction
layout = "nchw"                       or "nhwc"
multiple_of = 32                      required multiple of width and height, px
output = "disparity"                  name of the depth output; its first channel is used
unit = "px"                           of a stereo network: "px" of disparity, "normalised" (disparity divided
                                      by the width), "depth" or "inverse_depth" in metres; of a monocular
                                      network: "depth" or "inverse_depth" of unknown scale and shift
sign = 1                              −1 if the output is negated
confidence = "certainty"              name of an output from 0 to 1, where 1 is certain; optional
occlusion = "hidden"                  name of an output that is 1 where occluded in the right image; optional

[inputs]                              role of each network input
left = "left"                         "left", "right", "pair" for both in one input, or "image"; with the
right = "right"                       suffix "/2" at half the size
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

_ROLES = {STEREO: ("left", "right", "pair"), MONOCULAR: ("image",)}
_UNITS = {STEREO: (PX, NORMALISED, DEPTH, INVERSE_DEPTH), MONOCULAR: (INVERSE_DEPTH, DEPTH)}
_CHOICES = {
    "kind": (STEREO, MONOCULAR),
    "color": ("rgb", "bgr", "grey"),
    "layout": ("nchw", "nhwc"),
    "unit": _UNITS[STEREO],
}
_MAX_MULTIPLE = 1024
# Maximum length of an input or output name, characters.
_MAX_NAME_LENGTH = 200
_MAX_NUMBER = 1e6


@dataclass(frozen=True)
class Sidecar:
    """Input and output conventions of a network.

    The module docstring describes the fields.
    """

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
    # Not part of the sidecar: the file it was read from.
    file: Path | None = field(default=None, compare=False)

    def validate(self) -> Sidecar:
        """Validate the combination of fields.

        Returns
        -------
        The sidecar itself.

        Raises
        ------
        InputError
            If fields contradict each other.
        """
        taken = [what.removesuffix("/2") for what in self.inputs.values()]
        allowed = _ROLES[self.kind]
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
            raise InputError(DEPTH_NETWORK_SIDECAR_INVALID, "inputs must include left and right, or pair.")
        if self.unit not in _UNITS[self.kind]:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "unit is {unit!r}; for a monocular network it must be {units}.",
                unit=self.unit,
                units=" or ".join(_UNITS[self.kind]),
            )
        if self.range[0] == self.range[1] or not all(one > 0 for one in self.std):
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID, "the two values of range must differ, and std must be above 0."
            )
        return self

    @property
    def outputs(self) -> tuple[str, ...]:
        """Return the names of the requested outputs, depth first."""
        return (self.output, *(name for name in (self.confidence, self.occlusion) if name is not None))

    @property
    def channels(self) -> int:
        """Return the number of channels of an input image."""
        return 1 if self.color == "grey" else 3


def get_sidecar_path(network: Path) -> Path:
    """Return the path of a network's sidecar."""
    return network.with_suffix(".toml")


def read_sidecar(network: Path) -> Sidecar:
    """Read the sidecar of a network file.

    Raises
    ------
    InputError
        If the sidecar is missing, unreadable or invalid.
    """
    path = get_sidecar_path(network)
    if not path.is_file():
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            (
                "its sidecar {path_name} with input and output conventions is missing; "
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
            advice = f"did you mean {near[0]}?" if near else f"valid keys are {', '.join(known)}."
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "unknown key {name!r}; {advice}",
                path,
                name=name[:40],
                advice=advice,
            )
    for name in ("kind", "inputs", "output", "unit"):
        if name not in values:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID, "the required key {name} is missing.", path, name=name
            )
    try:
        return Sidecar(
            **{name: _check_value(name, value) for name, value in values.items()}, file=path
        ).validate()
    except InputError as error:
        raise error.replace_location(path) from None


def format_sidecar(sidecar: Sidecar) -> str:
    """Format a sidecar as TOML for `read_sidecar`."""
    lines = []
    for one in fields(Sidecar):
        value = getattr(sidecar, one.name)
        if one.name not in ("inputs", "file") and value is not None:
            lines.append(f"{one.name} = {_format_toml_value(value)}")
    inputs = (f"{json.dumps(name)} = {json.dumps(taken)}" for name, taken in sidecar.inputs.items())
    return "\n".join([*lines, "", "[inputs]", *inputs, ""])


def _format_toml_value(value: Any) -> str:
    if isinstance(value, tuple):
        return f"[{', '.join(f'{number:g}' for number in value)}]"
    return json.dumps(value, ensure_ascii=False)


def _check_value(name: str, value: Any) -> Any:
    """Validate and convert the value of a field.

    Raises
    ------
    InputError
        If the value is invalid; the message states the valid values.
    """
    if name in _CHOICES:
        if value not in _CHOICES[name]:
            raise InputError(
                USAGE_VALUE_INVALID,
                "{name} is {shown}; it must be one of {words}.",
                name=name,
                shown=_format_value(value),
                words=", ".join(_CHOICES[name]),
            )
        return value
    if name in ("output", "confidence", "occlusion"):
        return _check_name(name, value)
    if name == "range":
        return _check_numbers(name, value, 2)
    if name in ("mean", "std"):
        return _check_numbers(name, value, 3)
    if name == "sign":
        if value not in (1, -1) or isinstance(value, bool):
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "sign is {shown}; it must be 1 or -1.",
                shown=_format_value(value),
            )
        return int(value)
    if name == "multiple_of":
        if type(value) is not int or not 1 <= value <= _MAX_MULTIPLE:
            raise InputError(
                DEPTH_NETWORK_SIDECAR_INVALID,
                "multiple_of is {shown}; it must be from 1 to {most_multiple}.",
                shown=_format_value(value),
                most_multiple=_MAX_MULTIPLE,
            )
        return value
    if not isinstance(value, dict) or not value:
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID, "inputs must be a table that maps each network input to its role."
        )
    return {
        _check_name("inputs", key): _check_name(f"inputs.{key[:40]}", taken) for key, taken in value.items()
    }


def _check_name(name: str, value: Any) -> str:
    if not isinstance(value, str) or not 0 < len(value) <= _MAX_NAME_LENGTH:
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            "{name} is {shown}; it must be a name.",
            name=name,
            shown=_format_value(value),
        )
    return value


def _check_numbers(name: str, value: Any, count: int) -> tuple[float, ...]:
    good = isinstance(value, list) and len(value) == count
    if not good or not all(type(one) in (int, float) and abs(one) <= _MAX_NUMBER for one in value):
        raise InputError(
            DEPTH_NETWORK_SIDECAR_INVALID,
            "{name} is {shown}; it must be {count} numbers.",
            name=name,
            shown=_format_value(value),
            count=count,
        )
    return tuple(float(one) for one in value)


def _format_value(value: Any) -> str:
    return repr(value)[:60]
