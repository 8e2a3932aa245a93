"""Options shared by `run` and `batch`, and the configuration built from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from scanloom.cli import completion
from scanloom.cli.codes import BATCH_OPTIONS_CONFLICT
from scanloom.cli.options import SetWords
from scanloom.cli.quality_option import load_config
from scanloom.stages.diagnostics.diagnostic import DiagnosticLocation
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.params import check_parameters, param

if TYPE_CHECKING:
    from scanloom.pipeline.config import Config

OutOption = Annotated[
    Path,
    typer.Option("--out", "-o", metavar="OUT", help="Folder for the results.", show_default=False),
]
ConfigOption = Annotated[
    Path | None,
    typer.Option(
        "--config", metavar="FILE", help="Parameters as TOML; see scanloom config.", show_default=False
    ),
]
UntilOption = Annotated[
    str | None,
    typer.Option(
        metavar="STAGE",
        help="Stop after this stage.",
        autocompletion=completion.complete_stages,
        show_default=False,
    ),
]
DryRunOption = Annotated[
    bool,
    typer.Option(
        "--dry-run",
        help="Print which stages would run, why, and the expected time and memory. Write nothing.",
    ),
]


@dataclass(frozen=True, kw_only=True)
class LimitsParams:
    """Memory and disk that a command may use."""

    memory: str | None = param(
        None,
        "Memory limit, such as `8 GB` (a number alone is MB). Work that would exceed the limit stops "
        "with an error.",
    )
    disk: str | None = param(
        None,
        "Limit of the disk space of results and cache, such as `20 GB`. Work that would exceed the limit "
        "stops with an error.",
    )

    def __post_init__(self) -> None:
        check_parameters(self)
        _parse_size(self.memory, "memory")
        _parse_size(self.disk, "disk")

    @property
    def memory_bytes(self) -> int | None:
        """Return the memory limit in bytes."""
        return _parse_size(self.memory, "memory")

    @property
    def disk_bytes(self) -> int | None:
        """Return the disk limit in bytes."""
        return _parse_size(self.disk, "disk")


@dataclass(frozen=True, kw_only=True)
class RunParams:
    """Cache of a run, and files and results that it replaces."""

    cache: str | None = param(
        None,
        "Folder that keeps the results of stages. Default: $SCANLOOM_CACHE, or OUT/cache.",
        is_path=True,
    )
    overwrite: bool = param(False, "Replace files in OUT that are not from a run, or were changed since.")
    force: str | None = param(
        None, "Stages that run again although their results are cached, such as `fuse` or `fuse,clean`."
    )

    def __post_init__(self) -> None:
        check_parameters(self)

    @property
    def cache_folder(self) -> Path | None:
        """Return the folder of the cache; None for the default."""
        return None if self.cache is None else Path(self.cache)

    @property
    def forced(self) -> tuple[str, ...]:
        """Return the names of these stages."""
        return split_words(self.force)


def split_words(text: str | None) -> tuple[str, ...]:
    """Split a comma-separated list."""
    return tuple(word for part in (text or "").split(",") if (word := part.strip()))


def config_sections() -> Mapping[str, Any]:
    """Return the parameters of each section of a run's configuration, with their defaults."""
    from scanloom.pipeline.config import Config

    return {name: getattr(Config(), name) for name in Config.get_types()}


ConfigWords = Annotated[list[str], SetWords(config_sections)]


def load_run_config(
    file: Path | None,
    quality: str | None,
    words: Sequence[str],
    scan: Mapping[str, Any] | None = None,
    simplify: Mapping[str, Any] | None = None,
) -> Config:
    """Build the configuration from options, with all checks that need no scan.

    Parameters
    ----------
    words : of `--set`.
    scan, simplify : parameters of these sections, from options.
    """
    from scanloom.stages.params import resolve
    from scanloom.stages.simplification.method_selection import select_method
    from scanloom.stages.simplification.params import SimplifyParams

    config = load_config(file, quality).set(words)
    config = replace(
        config,
        scan=replace(config.scan, **(scan or {})),
        simplify=resolve(SimplifyParams, config.simplify, dict(simplify or {})),
    )
    # Report conflicting parameters of `simplify` now, not after hours of fusion.
    select_method(config.simplify)
    return config


def _parse_size(size: str | None, name: str) -> int | None:
    """Return a size in bytes.

    Raises
    ------
    UsageError
        If the text is not a size, or is 0.
    """
    from scanloom.pipeline.cache.cache_size import parse_size

    if size is None:
        return None
    count = parse_size(size, name)
    if count == 0:
        raise UsageError(
            BATCH_OPTIONS_CONFLICT,
            "is {size}, which would exclude every scan",
            DiagnosticLocation(parameter=name),
            remedy="omit it for no limit.",
            size=size,
        )
    return count
