"""Diagnostics in the words of the command line."""

from __future__ import annotations

import re
from dataclasses import replace

from scanloom.stages.diagnostics.diagnostic import Diagnostic


def option_name(field_name: str) -> str:
    """Return the option of a field, such as `ratio` or `planar.crease_angle`."""
    return "--" + field_name.rpartition(".")[2].replace("_", "-")


def as_typed(text: str) -> str:
    """Write advice such as `scan.depth_scale=1000` as the option every command on scans has for it."""
    return re.sub(r"\bscan\.(\w+)=", lambda found: f"{option_name(found[1])}=", text)


def render(diagnostic: Diagnostic) -> str:
    """Return a diagnostic as one sentence that names parameters as options."""
    where = diagnostic.where
    if where is not None and where.parameter is not None and where.section is None:
        where = replace(where, parameter=option_name(where.parameter))
    return as_typed(str(replace(diagnostic, where=where)))
