"""A diagnostic, and the code that it is an instance of."""

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
    WARNING : the result is written, but something was left out, assumed or changed.
    UNMET : the result is written, but a requirement of the user is not reached.
    ERROR : there is no result.
    """

    INFO = "info"
    WARNING = "warning"
    UNMET = "unmet"
    ERROR = "error"


@dataclass(frozen=True)
class Where:
    """Location that a diagnostic is about.

    Attributes
    ----------
    file : path, or the name of an argument such as "mesh".
    frame : name of a frame.
    parameter : name of a parameter, which begins the message: "voxel_size" + "is 0; …".
    section : of the configuration, which has the parameter.
    stage : of the pipeline, in which it was emitted.
    scan : name in a batch.
    """

    file: str | None = None
    frame: str | None = None
    parameter: str | None = None
    section: str | None = None
    stage: str | None = None
    scan: str | None = None

    def figures(self) -> dict[str, str]:
        """Return what is known, ready for JSON."""
        return {name: value for name, value in vars(self).items() if value is not None}

    def __str__(self) -> str:
        """Return the location as the beginning of a sentence."""
        frame = None if self.frame is None else f"frame {self.frame}"
        place = "".join(f"{part}: " for part in (self.scan, self.stage, self.file, frame) if part is not None)
        if self.parameter is None:
            return place
        section = "" if self.section is None else f"{self.section}."
        return f"{place}{section}{self.parameter} "


Location = Where | Path | str | None


@dataclass(frozen=True)
class Diagnostic:
    """One instance of something wrong, odd or not reached.

    Attributes
    ----------
    code : name of the code, such as "file.damaged"; see docs/when-it-goes-wrong.
    severity : whether there is a result, and whether it is what was asked for.
    message : complete sentences with units, in the words of Python and TOML.
    remedy : what the user can do.
    where : file, frame or parameter.
    values : numbers and names in the message.
    """

    code: str
    severity: Severity
    message: str
    remedy: str | None = None
    where: Where | None = None
    values: Mapping[str, float | int | str] = field(default_factory=dict, hash=False)

    def __str__(self) -> str:
        where = "" if self.where is None else str(self.where)
        if self.remedy is None:
            return where + self.message
        return f"{where}{self.message}{' ' if self.message.endswith(_ENDS) else '; '}{self.remedy}"

    def at(self, where: Location) -> Diagnostic:
        """Return the diagnostic with another location."""
        return replace(self, where=_as_where(where))

    def within(self, **parts: str | None) -> Diagnostic:
        """Return the diagnostic with some fields of its location replaced, such as `stage` or `section`."""
        where = replace(self.where or Where(), **parts)
        return replace(self, where=None if where == Where() else where)

    def figures(self) -> dict[str, Any]:
        """Return the diagnostic ready for JSON."""
        figures: dict[str, Any] = {
            "code": self.code,
            "severity": self.severity.value,
            "message": self.message,
            "remedy": self.remedy,
            "where": {} if self.where is None else self.where.figures(),
            "values": dict(self.values),
        }
        return {name: value for name, value in figures.items() if value not in (None, {})}

    @classmethod
    def from_figures(cls, figures: Mapping[str, Any]) -> Diagnostic:
        """Create the diagnostic that `figures` returned.

        Raises
        ------
        KeyError, TypeError, ValueError
            If they are not those of a diagnostic.
        """
        where = figures.get("where")
        return cls(
            figures["code"],
            Severity(figures["severity"]),
            figures["message"],
            figures.get("remedy"),
            None if where is None else Where(**where),
            figures.get("values", {}),
        )


@dataclass(frozen=True)
class Code:
    """Kind of diagnostic, declared once next to the modules that emit it.

    Attributes
    ----------
    name : topic and kind, such as "file.damaged"; stable, and part of JSON.
    title : what all diagnostics of this code have in common; a heading of the documentation.
    explanation : causes and remedies, Markdown.
    example : message as it is printed.

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
        if self.name in _DECLARED:
            raise ValueError(f"the code {self.name} is declared twice")
        _DECLARED[self.name] = self

    def info(self, message: str, /, where: Location = None, *, remedy: str = "", **values: Any) -> Diagnostic:
        """Create a diagnostic that only informs; see `create`."""
        return self.create(Severity.INFO, message, where, remedy, values)

    def warning(
        self, message: str, /, where: Location = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create a warning; see `create`."""
        return self.create(Severity.WARNING, message, where, remedy, values)

    def unmet(
        self, message: str, /, where: Location = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create a diagnostic of a requirement that is not reached; see `create`."""
        return self.create(Severity.UNMET, message, where, remedy, values)

    def error(
        self, message: str, /, where: Location = None, *, remedy: str = "", **values: Any
    ) -> Diagnostic:
        """Create an error that is kept and not raised; see `create`."""
        return self.create(Severity.ERROR, message, where, remedy, values)

    def create(
        self, severity: Severity, message: str, where: Location, remedy: str, values: Mapping[str, Any]
    ) -> Diagnostic:
        """Create a diagnostic of this code.

        Parameters
        ----------
        message : complete sentence; with values it is a template of `str.format`.
        where : the file, frame or argument that the message is about.
        remedy : what the user can do; a template, too.
        values : fields of the templates, such as counts and lengths.
        """
        if values:
            message, remedy = message.format(**values), remedy.format(**values)
        kept = {name: _simple(value) for name, value in values.items()}
        return Diagnostic(self.name, severity, message, remedy or None, _as_where(where), kept)


_ENDS = (".", "?", "!")
# All declared codes by name.
_DECLARED: dict[str, Code] = {}


def declared_codes() -> dict[str, Code]:
    """Return the codes of all modules that are imported, by name."""
    return dict(_DECLARED)


def _as_where(where: Location) -> Where | None:
    return where if where is None or isinstance(where, Where) else Where(str(where))


def _simple(value: Any) -> float | int | str:
    """Return a value that JSON can hold."""
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    if isinstance(value, (int, float, str)):
        return value
    if hasattr(value, "item") and getattr(value, "size", 0) == 1:
        return _simple(value.item())
    return str(value)
