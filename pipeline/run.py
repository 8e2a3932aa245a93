"""Run the whole pipeline: a scan folder in, results under plain names in an output folder."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.cache import Cache
from pipeline.config import Config
from pipeline.digest import scan_digest
from pipeline.engine import Engine, Outcome, Source, Stage
from pipeline.events import Events, RunStarted, StageProgress, Warned, unwatched
from pipeline.failures import explained
from pipeline.graph import STAGES, is_registered, left_out, plan_for, source_of
from pipeline.report import compose, to_json
from stages.errors import UsageError
from stages.scans.read import read_scan, require_complete
from stages.scans.scan import Scan

CACHE_VARIABLE = "SCANLOOM_CACHE"


@dataclass(frozen=True)
class RunResult:
    """What a run came to.

    Attributes
    ----------
    out : the output folder.
    cache : the cache folder.
    stages : what became of each stage that was asked for, in order.
    report : the content of report.json.
    """

    out: Path
    cache: Path
    stages: tuple[Outcome, ...]
    report: Mapping[str, Any]

    def figures(self) -> dict[str, Any]:
        """Return the report, and where the results are."""
        return {"out": str(self.out), "cache": str(self.cache), **self.report}


def run(
    scan_folder: Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    until: str | None = None,
    force: Collection[str] = (),
    cache_dir: Path | str | None = None,
    events: Events = unwatched,
) -> RunResult:
    """Take a scan from its folder to a light mesh and a report; stages that need not run are not run.

    Parameters
    ----------
    scan_folder : read only.
    out : made if need be; gets fused.ply, clean.ply, simplified.ply, report.json, pictures/, for stereo
        points.ply, with `bake.enabled` baked.glb, and with `remesh.enabled` remeshed.ply, remeshed.snm and
        levels/. Files there that a run placed and that belong to no current result are removed.
    until : the last stage to run.
    force : stages to run even though their results are cached.
    cache_dir : see `cache_folder`.
    events : told what happens, from this thread.

    Raises
    ------
    InputError
        If the scan cannot be used.
    UsageError
        For an unknown stage, a wrong parameter, or an output folder that is the scan itself.
    StageError
        If a stage fails, or the machine runs out of disk or memory.
    """
    config = config or Config()
    scan_folder, out = Path(scan_folder).resolve(), Path(out).resolve()
    cache = Cache(cache_folder(out, cache_dir), lambda text: events(Warned(text)))
    for folder, what in ((out, "output"), (cache.folder, "cache")):
        if folder == scan_folder:
            raise UsageError(
                f"{folder}: the {what} folder is the scan itself, which is only read; name another."
            )
    known = [stage.name for stage in STAGES]
    for name in (*force, *([] if until is None else [until])):
        _require_stage(name, known)
    scan = read_scan(scan_folder, config.scan, complete=False)
    require_complete(scan, scan_folder, posed=not is_registered(scan, config))
    plan = plan_for(scan, config)
    until = until or plan[-1].name
    absent = left_out(scan, config)
    for name in (*force, until):
        if name in absent:
            raise UsageError(f"{name} {absent[name]}.")
    return _run(scan, plan, out, config, until, force, cache, events)


def cache_folder(out: Path, given: Path | str | None = None) -> Path:
    """Return where results are kept: what is given, else $SCANLOOM_CACHE, else `out/cache`."""
    chosen = given or os.environ.get(CACHE_VARIABLE)
    return Path(chosen).resolve() if chosen else out / "cache"


def _run(
    scan: Scan,
    plan: Sequence[Stage],
    out: Path,
    config: Config,
    until: str,
    force: Collection[str],
    cache: Cache,
    events: Events,
) -> RunResult:
    names = [stage.name for stage in plan]
    planned = tuple(names[: names.index(until) + 1])
    warnings = list(scan.warnings)
    if scan.skipped:
        first = scan.skipped[0]
        warnings.append(f"{len(scan.skipped)} frames cannot be used; the first, {first.name}: {first.reason}")
    events(RunStarted(scan.layout, len(scan.frames), tuple(warnings), planned))
    with explained(f"the output folder {out} cannot be used"):
        out.mkdir(parents=True, exist_ok=True)
    cache.remove_abandoned()
    content = scan_digest(scan, lambda done, total: events(StageProgress("scan", done, total)))
    source = Source(content.digest, scan, content.parts, content.require_unchanged)
    with Engine(plan, config, {source_of(scan): source}, cache, out, events) as engine:
        engine.results.withdraw_others(names)
        outcomes = tuple(engine.run(until, force))
        final = engine.withdraw_outdated(until)
        report = compose(scan, outcomes, {} if final is None else final.figures, out)
        engine.results.write_report(to_json(report))
    return RunResult(out, cache.folder, outcomes, report)


def _require_stage(name: str, known: Sequence[str]) -> None:
    if name not in known:
        near = difflib.get_close_matches(name, known, n=1)
        raise UsageError(
            f"there is no stage {name!r}; "
            + (f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}.")
        )
