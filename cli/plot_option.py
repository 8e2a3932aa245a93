"""Option --plot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from scanloom.cli.paths import require_new_file


def plot_option(what: str) -> Any:
    """Return the option --plot that draws `what`."""
    return typer.Option(
        "--plot",
        metavar="FILE",
        help=f"Draw {what}, as .png or .svg; needs scanloom[plot].",
        show_default=False,
    )


def require_plot(path: Path | None) -> None:
    """Check that a plot can be drawn and written; None means no plot."""
    if path is None:
        return
    from scanloom.stages.rendering.plots import SUFFIXES, require_plots

    require_new_file(path, SUFFIXES)
    require_plots()
