"""The whole way, and what belongs to it: run, config, cache."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from cli.errors import STAGE_FAILED
from cli.options import Changes, with_options
from cli.output import Output, size_of, table_of
from cli.paths import require_scan, require_writable
from cli.watch import tell_skipped, watching
from stages import InputError, ScanParams, UsageError
from stages.params import check, param

if TYPE_CHECKING:
    from pipeline.cache import Cache, Listed
    from pipeline.run import RunResult

CacheFolder = Annotated[
    Path | None,
    typer.Argument(
        metavar="DIR",
        help="Cache folder, or the output folder of a run; $SCANLOOM_CACHE if not given.",
        show_default=False,
    ),
]

_DAY = 86_400.0
_MEGABYTE = 1_000_000


@dataclass(frozen=True, kw_only=True)
class PruneParams:
    """What to remove from a cache."""

    all: bool = param(False, "Also remove what the latest run of an output folder used.")
    older_than: float | None = param(
        None, "Remove what was last used longer ago; without it age does not count.", unit="days", low=0
    )
    max_size: float | None = param(
        None, "Then remove what was unused longest until the rest is no larger.", unit="MB", low=0
    )
    dry_run: bool = param(False, "Only say what would be removed.")

    def __post_init__(self) -> None:
        check(self)


def add_to(app: typer.Typer) -> None:
    """Register the commands."""
    app.command("run", rich_help_panel="From scan to mesh")(with_options(run))
    app.command("config", rich_help_panel="From scan to mesh")(with_options(config))
    cache = typer.Typer(rich_markup_mode="rich")
    cache.command("ls")(with_options(cache_ls))
    cache.command("verify")(with_options(cache_verify))
    cache.command("prune")(with_options(cache_prune))
    app.add_typer(
        cache,
        name="cache",
        help="Look after the kept results of stages.",
        rich_help_panel="From scan to mesh",
    )


def run(
    scan: Annotated[
        Path,
        typer.Argument(
            metavar="SCAN",
            help="Folder of the scan, or a recording (.bag, .db3, .sens, .r3d).",
            show_default=False,
        ),
    ],
    target: Annotated[
        Path,
        typer.Option("--out", "-o", metavar="OUT", help="Folder for the results.", show_default=False),
    ],
    scan_options: Changes[ScanParams],
    out: Output,
    config_file: Annotated[
        Path | None,
        typer.Option(
            "--config", metavar="FILE", help="Parameters as TOML; see scanloom config.", show_default=False
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="STAGE.PARAM=VALUE",
            help="Change one parameter, after --config; may be given many times.",
            show_default=False,
        ),
    ] = None,
    until: Annotated[
        str | None, typer.Option(metavar="STAGE", help="Stop after this stage.", show_default=False)
    ] = None,
    force: Annotated[
        list[str] | None,
        typer.Option(
            metavar="STAGE",
            help="Run this stage even though its result is cached; may be given many times.",
            show_default=False,
        ),
    ] = None,
    cache: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where the results of stages are kept; $SCANLOOM_CACHE, or OUT/cache, if not given.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Make a light, coloured mesh from a scan folder; every stage's result is kept and reused.

    OUT then holds fused.ply, clean.ply, simplified.ply, report.json and pictures. A second run does only
    what has changed since. With --set bake.enabled=true it also holds baked.glb: the simplified mesh with a
    texture that shows all colour. With --set remesh.enabled=true it holds a normal mesh: remeshed.ply, all
    its levels, and remeshed.snm.

    Example: scanloom run my_scan -o my_mesh --set fuse.voxel_size=0.01 --set simplify.max_shape=0.005
    """
    from pipeline.config import Config
    from pipeline.run import run as run_pipeline

    require_scan(scan)
    config = Config.load(config_file) if config_file is not None else Config()
    config = config.set(settings or ())
    config = replace(config, scan=replace(config.scan, **scan_options))
    config.simplify.chosen()  # what does not go together is said now, not after hours of fusion
    require_writable(target)
    with watching(out) as events:
        result = run_pipeline(
            scan, target, config, until=until, force=tuple(force or ()), cache_dir=cache, events=events
        )
    tell_skipped(out, "the reader", result.report["scan"])
    out.result(result.figures(), _summary(result))


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


def cache_ls(out: Output, folder: CacheFolder = None) -> None:
    """List the kept results: stage, key, size, last use.

    Example: scanloom cache ls
    """
    cache = _open(folder)
    _print_entries(cache.folder, cache.ls(), out)


def cache_verify(out: Output, folder: CacheFolder = None) -> None:
    """Read every kept result and say which are damaged; the exit code is 1 if any is.

    Damaged results are made anew by the next run that needs them.

    Example: scanloom cache verify
    """
    cache = _open(folder)
    entries = cache.verify()
    _print_entries(cache.folder, entries, out)
    if any(entry.problem for entry in entries):
        raise typer.Exit(STAGE_FAILED)


def cache_prune(params: PruneParams, out: Output, folder: CacheFolder = None) -> None:
    """Remove kept results that the latest run of no output folder used.

    Example: scanloom cache prune --older-than 30
    """
    cache = _open(folder)
    removed = cache.prune(
        older_than=0.0 if params.all else None if params.older_than is None else params.older_than * _DAY,
        max_size=None if params.max_size is None else int(params.max_size * _MEGABYTE),
        dry_run=params.dry_run,
    )
    _print_entries(cache.folder, removed, out, "would be removed" if params.dry_run else "removed")


def _summary(result: RunResult) -> str:
    """Say how good the final mesh is, and where the results are."""
    mesh = result.report["mesh"]
    lines = []
    if mesh is not None:
        # One way only: the other way would mostly tell how far away the islands were that cleaning removed.
        distance = mesh["to_fused"]["distance"]["b_to_a"]
        color = (mesh["to_fused"]["color"] or {}).get("b_to_a")
        lines += [
            f"{mesh['triangles']:,} triangles, {'' if mesh['manifold'] else 'not '}manifold",
            f"off the fused mesh by {distance['rms_m']:.3g} m RMS, {distance['maximum_m']:.3g} m at most"
            + (f"; colour by {color['rmse_levels']:.3g} of 255 levels RMS" if color else ""),
        ]
    placed = [path.relative_to(result.out).parts for stage in result.stages for path in stage.results]
    names = dict.fromkeys(parts[0] + ("/" if parts[1:] else "") for parts in placed)
    lines.append(f"results in {result.out}: {', '.join([*names, 'report.json'])}")
    return "\n".join(lines)


def _open(folder: Path | None) -> Cache:
    from pipeline.cache import Cache
    from pipeline.run import CACHE_VARIABLE, cache_folder

    if folder is None and CACHE_VARIABLE not in os.environ:
        raise UsageError(
            f"which cache? Give its folder, or the output folder of a run, or set {CACHE_VARIABLE}."
        )
    chosen = Path(os.environ[CACHE_VARIABLE]) if folder is None else folder
    for place in (chosen, cache_folder(chosen)) if chosen.is_dir() else ():
        if (place / "CACHEDIR.TAG").is_file():
            return Cache(place)
    raise InputError("there is no cache here.", chosen)


def _print_entries(folder: Path, entries: Sequence[Listed], out: Output, done: str = "kept") -> None:
    total = sum(entry.size for entry in entries)
    figures = {
        "cache": str(folder),
        "entries": [
            {
                "stage": entry.stage,
                "key": entry.key,
                "size_bytes": entry.size,
                "last_used": entry.last_used.isoformat(timespec="seconds"),
                "in_latest_run": entry.in_latest_run,
                "problem": entry.problem,
            }
            for entry in entries
        ],
        "total_bytes": total,
    }
    rows = [["stage", "key", "size", "last used", "in latest run"]]
    for entry in entries:
        when = entry.last_used.astimezone().strftime("%Y-%m-%d %H:%M")
        rows.append(
            [entry.stage, entry.key[:12], size_of(entry.size), when, "yes" if entry.in_latest_run else "no"]
        )
    lines = [table_of(rows)] if entries else []
    lines += [f"{e.stage}/{e.key[:12]} is damaged: {e.problem}" for e in entries if e.problem]
    lines.append(f"{len(entries)} result{'s' * (len(entries) != 1)} {done} in {folder}, {size_of(total)}.")
    out.result(figures, "\n".join(lines))
