"""The command `config`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from scanloom.cli.output import Output
from scanloom.cli.quality import QualityOption, config_of, quality_toml


def config(
    out: Output,
    file: Annotated[
        Path | None,
        typer.Option(
            "--check", metavar="FILE", help="Check this file, and print all that it sets.", show_default=False
        ),
    ] = None,
    quality: QualityOption = None,
) -> None:
    """Print every parameter of every stage as TOML: its default, unit, range and meaning.

    With --quality first what that sets; parameters that are left out of a file are then of that quality.

    Example: scanloom config > my.toml
    """
    from scanloom.pipeline.config import Config

    chosen = config_of(file, quality)
    figures = {name: asdict(getattr(chosen, name)) for name in Config.types()}
    text = chosen.dumps().rstrip()
    out.result(figures, text if quality is None else f"{quality_toml(quality)}\n{text}")
