"""Cameras as text lines of names and numbers: script output, .ini files, rs-enumerate-devices.

    fx: 615.2            PPX (cx) = 318.5            baseline 0.05

Headings separate several cameras: `[rgb]`, or `Intrinsic of "Color" / 640x480 / {YUYV}`.
"""

from __future__ import annotations

import re
from typing import Any

_NAME_VALUE_LINE = re.compile(r"([A-Za-z][\w. ]{0,40}?) ?(?:\(([^)]{0,40})\))? ?[:=,] ?(.{1,400})")
_SPACED_LINE = re.compile(r"([A-Za-z]\w{0,40})() ([-+.\d].{0,400})")
_HEADING = re.compile(r"\[([^\]]{1,80})\]|((?:in|ex)trinsics? (?:of|from) .{1,120}?):?", re.IGNORECASE)
_SEPARATORS = re.compile(r"[\s,;\[\]{}]+")
_ALIASES = {"ffx": "fx", "ffy": "fy"}
_ROW_KEYS = ("distortion", "coeffs")
_KNOWN_KEYS = re.compile(
    r"f?f[xy]|c[xy]|pp[xy]|width|height|[kp][1-6]|coeffs|distortion|model|baseline|depth_scale"
)


def parse_named_text(text: str) -> dict[str, Any] | None:
    """Parse name-value lines into a table with one nested table per heading.

    Returns None if no table has `fx` and `fy`.
    """
    whole: dict[str, Any] = {}
    here = whole
    for line in text.splitlines():
        # With single spaces, no two parts of a pattern can match the same spaces.
        words = " ".join(line.partition("#")[0].split())
        heading = _HEADING.fullmatch(words)
        if heading is not None:
            name = (heading[1] or heading[2]).strip()
            here = {}
            whole[name if name not in whole else f"{name} ({len(whole)})"] = here
            continue
        named = _NAME_VALUE_LINE.fullmatch(words) or _SPACED_LINE.fullmatch(words)
        if named is not None:
            _store_value(here, *named.groups())
    found = [whole, *(one for one in whole.values() if isinstance(one, dict))]
    return whole if any({"fx", "fy"} <= one.keys() for one in found) else None


def _store_value(table: dict[str, Any], name: str, alias: str | None, value: str) -> None:
    """Store a value under its calibration key, if one of its names is known."""
    names = [one.strip().lower() for one in (name, alias or "") if _KNOWN_KEYS.fullmatch(one.strip().lower())]
    if not names:
        return
    key = _ALIASES.get(names[0], names[0])
    words = [word for word in _SEPARATORS.split(value) if word]
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        # The name of the lens model, on a separate line from its coefficients.
        if key in ("distortion", "model"):
            table["model"] = value.strip()
        return
    if numbers:
        table[key] = numbers[0] if len(numbers) == 1 and key not in _ROW_KEYS else numbers
