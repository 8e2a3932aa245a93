"""The option --quality, and the configuration that it and --config come to."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanloom.pipeline.quality import QUALITIES, STANDARD
from scanloom.stages.diagnostics.codes import USAGE_OPTIONS_CONFLICT
from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.params import flatten, get_value

if TYPE_CHECKING:
    from scanloom.pipeline.config import Config

QualityOption = Annotated[
    str | None,
    typer.Option(
        "--quality",
        metavar="|".join(QUALITIES),
        help="What parameters that are not given are: for a first look in a fraction of the time, as usual, "
        f"or as good as it gets. Default: that of --config, else {STANDARD}.",
        autocompletion=lambda: list(QUALITIES),
        show_default=False,
    ),
]


def config_of(file: Path | None, quality: str | None) -> Config:
    """Return the parameters of a file, and for all that it leaves open those of a quality.

    What the file keeps from the quality that was asked for is a warning.
    """
    from scanloom.pipeline.config import Config

    if file is None:
        return Config.of(STANDARD if quality is None else quality)
    config = Config.load(file, quality)
    kept = [
        f"{section}.{name}"
        for section, values in QUALITIES[quality or STANDARD].items()
        for name, value in flatten(values).items()
        if get_value(getattr(config, section), name) != value
    ]
    if kept:
        emit(
            USAGE_OPTIONS_CONFLICT.warning(
                "--quality {quality} leaves {parameters} as {file} sets them",
                remedy="leave them out there.",
                quality=quality,
                parameters=", ".join(kept),
                file=file,
            )
        )
    return config


def quality_toml(quality: str) -> str:
    """Return the line of a configuration that names a quality, after a comment on what it sets."""
    sets = [f"{section}.{name}" for section, values in QUALITIES[quality].items() for name in flatten(values)]
    told = f"{quality} sets {', '.join(sets)}." if sets else f"{quality} sets nothing: all are the defaults."
    words = f"What parameters that are left out are: {', '.join(QUALITIES)}. {told}"
    comment = textwrap.wrap(words, 100, initial_indent="# ", subsequent_indent="# ")
    return "\n".join([*comment, f'quality = "{quality}"', ""])
