"""Option --quality, and the configuration from --quality and --config."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from scanloom.pipeline.quality_presets import QUALITIES, STANDARD
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
        help="Preset of parameter defaults, from fastest to best. Default: the preset of --config, else "
        f"{STANDARD}.",
        autocompletion=lambda: list(QUALITIES),
        show_default=False,
    ),
]


def load_config(file: Path | None, quality: str | None) -> Config:
    """Load the parameters of a file, with the defaults of a quality.

    Warns if the file overrides parameters of the quality.
    """
    from scanloom.pipeline.config import Config

    if file is None:
        return Config.from_quality(STANDARD if quality is None else quality)
    config = Config.load(file, quality)
    kept = [
        f"{name} of {section}"
        for section, values in QUALITIES[quality or STANDARD].items()
        for name, value in flatten(values).items()
        if get_value(getattr(config, section), name) != value
    ]
    if kept:
        emit(
            USAGE_OPTIONS_CONFLICT.warning(
                "the file overrides --quality {quality} in {parameters}",
                file,
                remedy="remove them from it.",
                quality=quality,
                parameters=", ".join(kept),
            )
        )
    return config


def format_quality(quality: str) -> str:
    """Return the line of TOML that names a quality, after a comment with the parameters that it sets."""
    sets = [f"{section}.{name}" for section, values in QUALITIES[quality].items() for name in flatten(values)]
    effect = f"{quality} sets {', '.join(sets)}." if sets else f"{quality} changes no parameter."
    words = f"Defaults of the other parameters: {', '.join(QUALITIES)}. {effect}"
    comment = textwrap.wrap(words, 100, initial_indent="# ", subsequent_indent="# ")
    return "\n".join([*comment, f'quality = "{quality}"', ""])
