"""The command `config`."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.output import Output

if TYPE_CHECKING:
    pass


def config(
    out: Output,
    file: Annotated[
        Path | None,
        typer.Option(
            "--check", metavar="FILE", help="Check this file, and print all that it sets.", show_default=False
        ),
    ] = None,
) -> None:
    """Print every parameter of every stage as TOML: its default, unit, range and meaning.

    Example: scanloom config > my.toml
    """
    from pipeline.config import Config

    chosen = Config.load(file) if file is not None else Config()
    figures = {name: asdict(getattr(chosen, name)) for name in Config.types()}
    out.result(figures, chosen.dumps().rstrip())
