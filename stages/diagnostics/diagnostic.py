"""Diagnostic, its location, severity and code."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from pathlib import Path
from typing import Any


class Severity(str, Enum):
    """Severity of a diagnostic.

    Attributes
    ----------
    INFO : nothing is lost.
    WARNING : the result is written, but something was skipped, assumed or changed.
    UNMET : the result is written, but a requirement of the user was not reached.
    ERROR : there is no result.
    """

    INFO = "info"
    WARNING = "warning"
    UNMET = "unmet"
    ERROR = "error"


@dataclass(frozen=True)
class DiagnosticLocation:
    """Location that a diagnostic refers to.

    Attributes
    ----------
    file : path, or the name of an argument such as "mesh".
    frame : name of a frame.
    parameter : name of a parameter. It begins the message: "voxel_size" + "is 0; …".
    section : configuration section of the parameter.
    stage : pipeline stage that emitted the diagnostic.
    scan : name of the scan in a batch.
    """

    file: str | None = None
    frame: str | None = None
    parameter: str | None = None
    section: str | None = None
    stage: str | None = None
    scan: str | None = None

    def to_dict(self) -> dict[str, str]:
        """Return the fields that are set, as a JSON object."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def __str__(self) -> str:
        """Return the location as the beginning of a sentence."""
        frame = None if self.frame is None else f"frame {self.frame}"
        place = "".join(f"{part}: " for part in (self.scan, self.stage, self.file, frame) if part is not None)
        if self.parameter is None:
            return place
        section = "" if self.section is None else f"{self.section}."
        return f"{place}{section}{self.parameter} "


LocationLike = DiagnosticLocation | Path | str | None


@dataclass(frozen=True)
class Diagnostic:
    """Warning, error, unmet requirement or notice.

    Attributes
    ----------
    code : name of the code, such as "file.damaged"; see docs/when-it-goes-wrong.
    severity : effect on the result.
    message : complete sentences with units; parameters are named as in Python and TOML.
    remedy : recommended action of the user.
    where : file, frame or parameter.
    values : numbers and names in the message.
    """

    code: str
    severity: Severity
    message: str
    remedy: str | None = None
    where: DiagnosticLocation | None = None
    values: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)

    def __str__(self) -> str:
        where = "" if self.where is None else str(self.where)
        if self.remedy is None:
            return where + self.message
        return f"{where}{self.message}{' ' if self.message.endswith(_SENTENCE_ENDS) else '; '}{self.remedy}"

    def replace_location(self, where: LocationLike) -> Diagnostic:
        """Return a copy with another location."""
        return replace(self, where=_to_location(where))

    def replace_location_fields(self, **parts: str | None) -> Diagnostic:
        """Return a copy with some location fields replaced, such as `stage` or `section`."""
        where = replace(self.where or DiagnosticLocation(), **parts)
        return replace(self, where=None if where == DiagnosticLocation() else where)

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnostic as a JSON object."""
        metrics: dict[str, Any] = {
            "code": self.code,
            "severity": self.severity.value,
            "message": self.message,
            "remedy": self.remedy,
            "where": {} if self.where is None else self.where.to_dict(),
            "values": dict(self.values),
        }
        return {name: value for name, value in metrics.items() if value not in (None, {})}

    @classmethod
    def from_dict(cls, metrics: Mapping[str, Any]) -> Diagnostic:
        """Create a diagnostic from the JSON object that `metrics` returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            If the object is not a diagnostic.
        """
        where = metrics.get("where")
        return cls(
            metrics["code"],
            Severity(metrics["severity"]),
            metrics["message"],
            metrics.get("remedy"),
            None if where is None else DiagnosticLocation(**where),
            metrics.get("values", {}),
        )


@dataclass(frozen=True)
class Code:
    """Kind of diagnostic, declared once next to the modules that emit it.

    Attributes
    ----------
    name : topic and kind, such as "file.damaged"; stable, and part of the JSON output.
    title : heading in the documentation that fits all diagnostics of this code.
    explanation : causes and remedies, Markdown.
    example : a message as printed.

    Raises
    ------
    ValueError
        If another code has this name.
    """

    name: str
    title: str
    explanation: str
    example: str

    def __post_init__(self) -> None:
        if self.name in _DECLARED_CODES:
            raise ValueError(f"the code {self.name} is declared twice")
        _DECLARED_CODES[self.name] = self

    def info(
        self, message: str, /, where: LocationLike = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create a notice that needs no action; see `create`."""
        return self.create(Severity.INFO, message, where, remedy, values)

    def warning(
        self, message: str, /, where: LocationLike = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create a warning; see `create`."""
        return self.create(Severity.WARNING, message, where, remedy, values)

    def unmet(
        self, message: str, /, where: LocationLike = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create a diagnostic for an unmet requirement; see `create`."""
        return self.create(Severity.UNMET, message, where, remedy, values)

    def error(
        self, message: str, /, where: LocationLike = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create an error without raising an exception; see `create`."""
        return self.create(Severity.ERROR, message, where, remedy, values)

    def create(
        self, severity: Severity, message: str, where: LocationLike, remedy: str, values: Mapping[str, Any]
    ) -> Diagnostic:
        """Create a diagnostic of this code.

        Parameters
        ----------
        message : complete sentence; a `str.format` template if there are values.
        where : file, frame or argument that the message refers to.
        remedy : recommended action of the user; also a template.
        values : fields of the templates, such as counts and lengths.
        """
        if values:
            message, remedy = message.format(**values), remedy.format(**values)
        kept = {name: _to_json_value(value) for name, value in values.items()}
        return Diagnostic(self.name, severity, message, remedy or None, _to_location(where), kept)


_SENTENCE_ENDS = (".", "?", "!")
_DECLARED_CODES: dict[str, Code] = {}


def get_declared_codes() -> dict[str, Code]:
    """Return the codes of all imported modules by name."""
    return dict(_DECLARED_CODES)


def _to_location(where: LocationLike) -> DiagnosticLocation | None:
    return where if where is None or isinstance(where, DiagnosticLocation) else DiagnosticLocation(str(where))


def _to_json_value(value: Any) -> float | int | str:
    """Convert a value to one that JSON supports.

    Scalar arrays become numbers, other values text.
    """
    # First, because the float64 of NumPy is a float, but not one that the cache stores.
    if hasattr(value, "item") and getattr(value, "size", 0) == 1:
        return _to_json_value(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, (int, float, str)):
        return value
    return str(value)
