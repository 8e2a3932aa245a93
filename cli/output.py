"""Output of a command: results on stdout; progress, remarks and warnings on stderr.

Warnings are about the result and are always printed. Remarks are about progress, such as a written file.
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
from scanloom.stages.printing import format_count, format_metric
from scanloom.stages.progress import Progress, ignore_progress

# Control characters, among them line breaks and terminal escapes, and the line separators and changes of the
# writing direction of Unicode.
_CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")
# Maximum length of a message, in characters. Longer messages quote a damaged file.
_MAX_LINE = 2000


class Output:
    """Output of one command; call `result` once, at the end.

    Parameters
    ----------
    as_json : print one JSON object to stdout, and only warnings, unmet requirements and failures to stderr.
    quiet : print no progress and no remarks.
    strict : exit with code 1 if there is a warning.
    can_warn : JSON includes `diagnostics`, possibly empty.

    Attributes
    ----------
    before_line : called before a line is written; progress bars remove themselves then.
    """

    def __init__(
        self, *, as_json: bool = False, quiet: bool = False, strict: bool = False, can_warn: bool = False
    ) -> None:
        self.as_json = as_json
        self.quiet = quiet or as_json
        self.before_line: Callable[[], None] = _do_nothing
        self._strict = strict
        self._can_warn = can_warn
        # Unique, in the order of their first report.
        self._diagnostics: dict[Diagnostic, None] = {}

    @property
    def exit_code(self) -> int:
        """Return the exit code of a command that has printed its result."""
        is_failed = self._count(Severity.UNMET) or (self._strict and self._count(Severity.WARNING))
        return FAILED if is_failed else DONE

    @property
    def has_progress_bar(self) -> bool:
        """Return True if progress is drawn as a bar, False if it is printed as lines or not at all."""
        return not self.quiet and sys.stderr.isatty()

    def remark(self, text: str) -> None:
        """Print a remark to stderr."""
        if not self.quiet:
            self._print(text)

    def report(self, diagnostic: Diagnostic) -> None:
        """Print a diagnostic to stderr once, and record it for JSON and the exit code.

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
        """Record a diagnostic that is printed elsewhere."""
        self._diagnostics[diagnostic] = None

    def result(self, metrics: Mapping[str, Any], text: str | None = None) -> None:
        """Print the result: JSON with --json, otherwise `text`, or the metrics line by line."""
        if self.as_json:
            diagnostics = [one.to_dict() for one in self._diagnostics]
            text = to_json(
                add_schema(
                    {**metrics, **({"diagnostics": diagnostics} if diagnostics or self._can_warn else {})}
                )
            )
        elif text is None:
            text = format_lines(metrics)
        # Names from files may hold terminal escapes. The lines of a result are its own.
        sys.stdout.write("\n".join(escape_controls(line) for line in text.split("\n")) + "\n")
        # Flush now: a full disk or a closed pipe can still be reported.
        sys.stdout.flush()
        warnings = self._count(Severity.WARNING)
        if self._strict and warnings and not self._count(Severity.UNMET):
            makes = "makes" if warnings == 1 else "make"
            count = format_count(warnings, "warning")
            self._print(f"scanloom: with --strict, {count} {makes} the exit code 1; the result is written.")

    def _count(self, severity: Severity) -> int:
        return sum(one.severity is severity for one in self._diagnostics)

    def _print(self, text: str) -> None:
        self.before_line()
        _write_line(text)

    @contextmanager
    def progress(self, label: str, unit: str = "") -> Iterator[Progress]:
        """Return a progress callback: a bar with rate and time left in a terminal, otherwise lines."""
        if self.quiet:
            yield ignore_progress
            return
        if not self.has_progress_bar:
            from scanloom.cli.progress_lines import print_progress_lines

            # Not `_print`: it ends the progress, and is called from another thread.
            with print_progress_lines(label, unit, _write_line) as update:
                yield update
            return
        from scanloom.cli.progress_bar import draw_progress_bar

        with draw_progress_bar(label, unit) as update:
            yield update


def _write_line(text: str) -> None:
    sys.stderr.write(to_one_line(text) + "\n")
    sys.stderr.flush()


def _do_nothing() -> None:
    """Do nothing, because no progress bar is shown."""


def escape_controls(text: str) -> str:
    r"""Replace control characters by their escapes, such as `\x1b`."""
    return _CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode("ascii"), text)


def to_one_line(text: str) -> str:
    r"""Return text as a single line: escape control characters, and shorten the middle."""
    line = escape_controls(text.rstrip())
    return line if len(line) <= _MAX_LINE else f"{line[: _MAX_LINE // 2]} … {line[-_MAX_LINE // 2 :]}"


def add_schema(metrics: Mapping[str, Any]) -> dict[str, Any]:
    """Return metrics with the version of the JSON schema."""
    return {"schema": SCHEMA, **metrics}


def to_json(value: Any) -> str:
    """Return strictly valid JSON: non-finite values become null."""
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


def format_lines(metrics: Mapping[str, Any], indent: str = "") -> str:
    """Return metrics as aligned lines; nested metrics are indented under their name."""
    single = {key: format_metric(key, value) for key, value in metrics.items() if not _is_nested(value)}
    width = max((len(name) for name, _ in single.values()), default=0)
    lines = []
    for key, value in metrics.items():
        if key in single:
            name, text = single[key]
            lines.append(f"{indent}{name:<{width}}  {text}")
        else:
            lines.append(f"{indent}{format_metric(key, None)[0]}")
            nested = [value] if isinstance(value, Mapping) else value
            lines += [format_lines(item, indent + "  ") for item in nested]
    return "\n".join(lines)


def _is_nested(value: Any) -> bool:
    if isinstance(value, (list, tuple)):
        return any(isinstance(item, Mapping) for item in value)
    return isinstance(value, Mapping) and bool(value)


def format_table(rows: Sequence[Sequence[str]]) -> str:
    """Format rows as a table: first column left-aligned, others right-aligned."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0]), *(cell.rjust(w) for cell, w in zip(others, widths[1:], strict=True))]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


def format_size(count: int) -> str:
    """Return a number of bytes with a unit."""
    size, unit = float(count), "bytes"
    for larger in ("kB", "MB", "GB", "TB"):
        if size < 1000:
            break
        size, unit = size / 1000, larger
    return f"{size:.0f} {unit}" if unit == "bytes" else f"{size:.1f} {unit}"
