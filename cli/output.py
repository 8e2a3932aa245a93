"""Where a command's words go: results on stdout; progress, remarks and warnings on stderr.

What changes the result, or may spoil it, is a warning; it is never silenced. What only tells how work goes
on (a file that was written, a stage that is done) is a remark.
"""

from __future__ import annotations

import json
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

from scanloom.cli.exit_codes import DONE, FAILED
from scanloom.cli.rendering import render
from scanloom.pipeline.run.schema import SCHEMA
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.printing import counted, name_and_value
from scanloom.stages.progress import Progress, silent

# Control characters, among them line breaks and terminal escapes, and the line separators of Unicode.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")
# Maximum length of a message, in characters. Longer ones quote a damaged file.
_MAX_LINE = 2000


class Output:
    """Output of one command; `result` is called once, last.

    Parameters
    ----------
    as_json : stdout gets one JSON object; stderr only warnings, unmet requirements and failures.
    quiet : no progress and no remarks; the result is still printed, and so are warnings.
    strict : warnings make the exit code 1.
    can_warn : JSON has `diagnostics` also where there are none.

    Attributes
    ----------
    before_line : called before a line is written; a progress draw_progress_bar removes itself then.
    """

    def __init__(
        self, *, as_json: bool = False, quiet: bool = False, strict: bool = False, can_warn: bool = False
    ) -> None:
        self.as_json = as_json
        self.quiet = quiet or as_json
        self.before_line: Callable[[], None] = _do_nothing
        self._strict = strict
        self._can_warn = can_warn
        # In order, each once.
        self._diagnostics: dict[Diagnostic, None] = {}

    @property
    def exit_code(self) -> int:
        """Return the exit code of a command that has printed its result."""
        is_failed = self._count(Severity.UNMET) or (self._strict and self._count(Severity.WARNING))
        return FAILED if is_failed else DONE

    def remark(self, text: str) -> None:
        """Print what is going on to stderr."""
        if not self.quiet:
            self._print(text)

    def report(self, diagnostic: Diagnostic) -> None:
        """Print a diagnostic to stderr, once, and keep it for JSON and the exit code.

        Warnings and unmet requirements are printed with --quiet, too.
        """
        if diagnostic in self._diagnostics:
            return
        self.count(diagnostic)
        text = render(diagnostic)
        if diagnostic.severity is Severity.INFO:
            self.remark(text)
        elif diagnostic.severity is Severity.WARNING:
            self._print(f"warning: {text}")
        else:
            self._print(f"scanloom: {text}")

    def count(self, diagnostic: Diagnostic) -> None:
        """Keep a diagnostic that the user sees elsewhere."""
        self._diagnostics[diagnostic] = None

    def result(self, figures: Mapping[str, Any], text: str | None = None) -> None:
        """Print the result: JSON for a program, `text` (or the figures, one a line) for a person."""
        if self.as_json:
            told = [one.figures() for one in self._diagnostics]
            text = to_json(
                add_schema({**figures, **({"diagnostics": told} if told or self._can_warn else {})})
            )
        elif text is None:
            text = format_lines(figures)
        sys.stdout.write(text + "\n")
        # Here, not at exit, so that a full disk or a closed pipe is noticed while it can be reported.
        sys.stdout.flush()
        warnings = self._count(Severity.WARNING)
        if self._strict and warnings and not self._count(Severity.UNMET):
            makes = "makes" if warnings == 1 else "make"
            count = counted(warnings, "warning")
            self._print(f"scanloom: with --strict, {count} {makes} the exit code 1; the result is written.")

    def _count(self, severity: Severity) -> int:
        return sum(one.severity is severity for one in self._diagnostics)

    def _print(self, text: str) -> None:
        self.before_line()
        sys.stderr.write(to_one_line(text) + "\n")
        sys.stderr.flush()

    @contextmanager
    def progress(self, label: str, unit: str = "") -> Iterator[Progress]:
        """Return a progress callback, which draws a bar with rate and time left in a terminal."""
        if self.quiet or not sys.stderr.isatty():
            yield silent
            return
        from scanloom.cli.progress_bar import draw_progress_bar

        with draw_progress_bar(label, unit) as update:
            yield update


def _do_nothing() -> None:
    """Do nothing, where no progress draw_progress_bar is shown."""


def to_one_line(text: str) -> str:
    r"""Return text as one line: controls are escaped (a line break as \n), and the middle is cut if long."""
    line = _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text.rstrip())
    return line if len(line) <= _MAX_LINE else f"{line[: _MAX_LINE // 2]} … {line[-_MAX_LINE // 2 :]}"


def add_schema(figures: Mapping[str, Any]) -> dict[str, Any]:
    """Return figures as the object that a program reads, which says by which names it goes."""
    return {"schema": SCHEMA, **figures}


def to_json(value: Any) -> str:
    """Return JSON text that any reader takes: values that are not finite become null."""
    return json.dumps(_finite(value), indent=2, allow_nan=False, default=_plain)


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _plain(value: Any) -> Any:
    # NumPy numbers and arrays, and paths.
    return _finite(value.tolist()) if hasattr(value, "tolist") else str(value)


def format_lines(figures: Mapping[str, Any], indent: str = "") -> str:
    """Return figures as aligned lines for a person; nested ones are indented under their name."""
    single = {key: name_and_value(key, value) for key, value in figures.items() if not _is_nested(value)}
    width = max((len(name) for name, _ in single.values()), default=0)
    lines = []
    for key, value in figures.items():
        if key in single:
            name, text = single[key]
            lines.append(f"{indent}{name:<{width}}  {text}")
        else:
            lines.append(f"{indent}{name_and_value(key, None)[0]}")
            nested = [value] if isinstance(value, Mapping) else value
            lines += [format_lines(item, indent + "  ") for item in nested]
    return "\n".join(lines)


def _is_nested(value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return any(isinstance(item, Mapping) for item in value)
    return isinstance(value, Mapping) and bool(value)


def format_table(rows: Sequence[Sequence[str]]) -> str:
    """Return rows of words as columns: the first one flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(others, widths[1:], strict=True))]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def format_size(count: int) -> str:
    """Return a number of bytes as a person reads it."""
    size, unit = float(count), "bytes"
    for larger in ("kB", "MB", "GB", "TB"):
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{size:.0f} {unit}" if unit == "bytes" else f"{size:.1f} {unit}"
