"""Run of the whole pipeline, from scan to output folder."""

from __future__ import annotations

import difflib
import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from html import escape
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import compute_digest
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.cost_model import count_megapixels
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.evaluation.codes import REPORT_INCOMPLETE
from scanloom.pipeline.evaluation.params import ReportParams
from scanloom.pipeline.graph import STAGES, list_skip_reasons, plan_stages
from scanloom.pipeline.report.file_names import PAGE, REPORT
from scanloom.pipeline.report.page.show import Page
from scanloom.pipeline.report.run_page import make_run_page
from scanloom.pipeline.run.engine import Engine, StageOutcome
from scanloom.pipeline.run.events import RunEventHandler, RunStarted, StageProgress, ignore_run_event
from scanloom.pipeline.run.limits import NO_LIMITS, LimitGuard, Limits, limit_stage_memory
from scanloom.pipeline.run.output_folder import OutputFolder
from scanloom.pipeline.run.report_document import compose_report
from scanloom.pipeline.run.resource_estimation import estimate_stages
from scanloom.pipeline.run.run_request import RunRequest, make_paths_absolute
from scanloom.pipeline.run.sources import load_sources
from scanloom.pipeline.skipped_frames import warn_skipped_frames
from scanloom.pipeline.stage import AnyStage
from scanloom.pipeline.steps.adjust import is_adjusted
from scanloom.pipeline.steps.codes import USAGE_STAGE_SKIPPED
from scanloom.pipeline.steps.register import is_registered
from scanloom.pipeline.steps.structure import needs_structure
from scanloom.stages import __version__
from scanloom.stages.diagnostics.codes import CONFIG_PARAMETER_UNKNOWN
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic, Severity
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.path_safety import resolve_path
from scanloom.stages.printing import format_count, format_line, render_rows
from scanloom.stages.scans.model.scan import Scan
from scanloom.stages.scans.reader import read_scan, require_complete
from scanloom.stages.surface.memory_release import release_free_memory

CACHE_VARIABLE = "SCANLOOM_CACHE"


@dataclass(frozen=True)
class RunResult:
    """Result of a run.

    Attributes
    ----------
    out : output folder.
    cache : cache folder.
    stages : outcomes of the requested stages, in order.
    report : content of report.json.
    page : path of report.html; None if not written.
    diagnostics : diagnostics of the scan, the stages (cached or not), the cache and the page.
    """

    out: Path
    cache: Path
    stages: tuple[StageOutcome, ...]
    report: Mapping[str, Any]
    page: Path | None = None
    diagnostics: tuple[Diagnostic, ...] = ()

    def __repr__(self) -> str:
        return format_line(self, (str(self.out), *self._list_facts()))

    def _repr_html_(self) -> str:
        rows = [
            [
                one.stage,
                "cached" if one.cached else f"{one.seconds:.1f} s",
                f"{one.compute_cost['seconds']:.1f} s",
            ]
            for one in self.stages
        ]
        facts = ", ".join(fact for fact in self._list_facts() if fact)
        stage_table = render_rows([["stage", "this run", "computed in"], *rows])
        return f"<div><b>{escape(str(self.out))}</b>: {escape(facts)}{stage_table}</div>"

    def _list_facts(self) -> tuple[str, ...]:
        return (
            format_count(len(self.stages), "stage"),
            f"{sum(one.cached for one in self.stages)} cached",
            format_count((self.report["mesh"] or {"triangles": 0})["triangles"], "triangle"),
            format_count(len(self.unmet_requirements), "requirement not met", "requirements not met"),
        )

    def show(self, *, width: str = "100%", height: int = 640) -> Page:
        """Return the page of the run for a notebook.

        Parameters
        ----------
        width : CSS width of the frame.
        height : height of the frame in pixels.

        Raises
        ------
        UsageError
            If the run has no page.
        """
        if self.page is None:
            raise UsageError(
                REPORT_INCOMPLETE, "this run has no page; report.page=true and report.enabled=true write one."
            )
        html = read_input_bytes(self.page)
        return Page(title=self.out.name, html=html, width=width, height=height)

    @property
    def unmet_requirements(self) -> tuple[Diagnostic, ...]:
        """Requirements that were not met."""
        return tuple(one for one in self.diagnostics if one.severity is Severity.UNMET)

    def to_dict(self) -> dict[str, Any]:
        """Return the report with the paths of output folder, cache and page."""
        page = None if self.page is None else str(self.page)
        return {"out": str(self.out), "cache": str(self.cache), **self.report, "page": page}


def run(
    scan_folder: Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    until: str | None = None,
    force: Collection[str] = (),
    cache_dir: Path | str | None = None,
    overwrite: bool = False,
    limits: Limits = NO_LIMITS,
    events: RunEventHandler = ignore_run_event,
) -> RunResult:
    """Process a scan folder to a simplified mesh and a report, using cached results.

    Parameters
    ----------
    scan_folder : scan folder, never written to.
    out : output folder, created if needed. Files: fused.ply, clean.ply, refined.ply, simplified.ply,
        report.json, report.html, pictures/; textured.glb and texture_maps/ if frames have colour, else
        simplified.glb; adjusted/ if the adjustment was accepted; points.ply for stereo; web.glb with
        `export.web`; baked.glb with `bake.enabled`; remeshed.ply, remeshed.snm and levels/ with
        `remesh.enabled`; lod.slod and tiles/ with `lod.enabled`. Outdated files that a run placed
        there are removed.
    until : last stage to run.
    force : stages to recompute even if their results are cached.
    cache_dir : see `get_cache_folder`.
    overwrite : also replace files in `out` that no run placed there, or that were edited since.
    limits : memory and disk limits.
    events : callback for progress events, called from this thread.

    Raises
    ------
    InputError
        If the scan cannot be used, or `out` has a file in the way that no run placed.
    UsageError
        For an unknown stage, an invalid parameter, or an output folder that is the scan itself.
    StageError
        If a stage fails, the disk or memory is exhausted, or a limit is exceeded.
    """
    cache = Cache(get_cache_folder(resolve_path(out), cache_dir))
    prepared = prepare_run(scan_folder, out, config or Config(), until, force, cache)
    return run_prepared(prepared, cache, overwrite=overwrite, limits=limits, events=events)


@dataclass(frozen=True)
class PreparedRun:
    """Validated arguments of a run, with the scan read and the stages planned.

    Attributes
    ----------
    photos : scan of `texture.images`, or None.
    plan : all stages that apply to the scan.
    planned_names : names of the stages up to the last requested one.
    diagnostics : diagnostics of the scan and of the parameters.
    """

    scan: Scan
    photos: Scan | None
    out: Path
    config: Config
    plan: Sequence[AnyStage]
    planned_names: tuple[str, ...]
    force: Collection[str]
    diagnostics: tuple[Diagnostic, ...]


def prepare_run(
    scan_folder: Path | str,
    out: Path | str,
    config: Config,
    until: str | None,
    force: Collection[str],
    cache: Cache,
) -> PreparedRun:
    """Read the scan, validate the arguments, and plan the stages.

    See `run`. Nothing is written.
    """
    scan_folder, out = resolve_path(scan_folder), resolve_path(out)
    for folder, what in ((out, "output"), (cache.folder, "cache")):
        if folder == scan_folder:
            raise UsageError(
                FILE_OUTPUT_REFUSED,
                "the {what} folder is the scan itself, which is never written to",
                remedy="choose another folder.",
                where=folder,
                what=what,
            )
    check_stages([*force, *([] if until is None else [until])])
    scan = read_scan(scan_folder, config.scan, complete=False)
    require_complete(scan, scan_folder, posed=not (is_registered(scan, config) or needs_structure(scan)))
    plan = plan_stages(scan, config)
    until = until or plan[-1].name
    skipped = list_skip_reasons(scan, config)
    for name in (*force, until):
        if name in skipped:
            raise UsageError(USAGE_STAGE_SKIPPED, "{name} {absent}.", name=name, absent=skipped[name])
    names = [stage.name for stage in plan]
    with collecting() as diagnostics:
        if config.register.refine and config.register.enabled is None and is_adjusted(scan, config):
            emit(
                USAGE_STAGE_SKIPPED.warning(
                    "register.refine has no effect, because adjust refines the poses of frames with colour"
                )
            )
        warn_skipped_frames([one.to_dict() for one in scan.skipped_frames])
        planned = tuple(names[: names.index(until) + 1])
        photos = (
            _read_photos(config, scan)
            if any("photos" in one.input_names for one in plan[: len(planned)])
            else None
        )
    return PreparedRun(scan, photos, out, config, plan, planned, force, (*scan.diagnostics, *diagnostics))


def _read_photos(config: Config, scan: Scan) -> Scan | None:
    """Read the photos of `texture.images`, which replace the frames as source of the texture."""
    if config.texture.images is None:
        return None
    # No stage estimates poses of these photos.
    params = replace(config.photos, keep_unposed=False)
    with collecting(forward=False) as diagnostics:
        photos = read_scan(config.texture.images, params, complete=False)
    if not photos.is_metric and scan.scale is not None:
        # The photos share the world frame of the scan, so the unit of the scan applies.
        known = replace(params, scale=scan.scale.metres_per_unit)
        photos = read_scan(config.texture.images, known, complete=False)
    else:
        emit(*diagnostics)
    require_complete(photos, Path(config.texture.images), posed=True)
    return photos


def get_cache_folder(out: Path, given: Path | str | None = None) -> Path:
    """Return the cache folder: `given`, else $SCANLOOM_CACHE, else `out/cache`."""
    chosen = given or os.environ.get(CACHE_VARIABLE)
    return resolve_path(chosen) if chosen else out / "cache"


def run_prepared(
    prepared: PreparedRun,
    cache: Cache,
    *,
    overwrite: bool = False,
    limits: Limits = NO_LIMITS,
    events: RunEventHandler = ignore_run_event,
) -> RunResult:
    """Run a validated plan of `prepare_run`; see `run`."""
    with collecting() as diagnostics:
        result = _run_stages(prepared, cache, overwrite, limits, events)
    return replace(result, diagnostics=(*prepared.diagnostics, *diagnostics))


def _run_stages(
    prepared: PreparedRun, cache: Cache, overwrite: bool, limits: Limits, events: RunEventHandler
) -> RunResult:
    scan, out, planned = prepared.scan, prepared.out, prepared.planned_names
    config = limit_stage_memory(prepared.config, limits)
    events(RunStarted(scan.layout, len(scan.frames), planned, scan.is_metric))
    with convert_os_errors(f"the output folder {out} cannot be used"):
        out.mkdir(parents=True, exist_ok=True)
    cache.remove_abandoned()
    sources = load_sources(
        scan, config, prepared.photos, lambda done, total: events(StageProgress("scan", done, total))
    )
    guard = _make_guard(prepared, config, cache, limits)
    with Engine(
        prepared.plan,
        config,
        sources,
        cache,
        out,
        events,
        overwrite=overwrite,
        scan_folder=scan.folder,
        megapixels=count_megapixels(scan),
        guard=guard,
    ) as engine:
        if scan.folder is not None:
            engine.output_folder.record_request(
                RunRequest(scan.folder.absolute(), make_paths_absolute(config), planned[-1]).to_json()
            )
        engine.output_folder.check_replaceable(list_result_names(prepared))
        engine.output_folder.remove_other_stages([stage.name for stage in prepared.plan])
        outcomes = tuple(engine.run(planned[-1], prepared.force))
        final = engine.remove_outdated(planned[-1])
        report = compose_report(
            scan, prepared.diagnostics, outcomes, {} if final is None else final.metrics, out
        )
        written = engine.output_folder.write_report(report)
        page = _write_page(out, config.report, written, engine.output_folder, events, guard)
    if config.cache.max_bytes is not None:
        cache.limit_size(config.cache.max_bytes)
    return RunResult(out, cache.folder, outcomes, written, page)


def _make_guard(prepared: PreparedRun, config: Config, cache: Cache, limits: Limits) -> LimitGuard | None:
    if not limits:
        return None
    expected = estimate_stages(prepared.scan, config, prepared.planned_names, cache.folder)
    by_voxels = [stage.name for stage in prepared.plan if stage.cost.depends_on_voxel_size]
    return LimitGuard(limits, prepared.config, expected, by_voxels)


def _write_page(
    out: Path,
    params: ReportParams,
    report: Mapping[str, Any],
    results: OutputFolder,
    events: RunEventHandler,
    guard: LimitGuard | None,
) -> Path | None:
    """Write report.html unless it is up to date.

    Returns its path, or None if there is no page.
    """
    if not params.page or report["mesh"] is None:
        # Remove an outdated page: it would not match the results.
        results.has_current_page(_compute_page_params_digest(params))
        return None
    if results.has_current_page(_compute_page_params_digest(params)):
        return out / PAGE
    events(StageProgress("page", 0, 1))
    # Release memory freed by the last stage.
    release_free_memory()
    try:
        page = make_run_page(out, int(1e6 * params.page_size))
    except InputError as error:
        emit(REPORT_INCOMPLETE.warning("{page} is not written: {reason}", page=PAGE, reason=str(error)))
        return None
    events(StageProgress("page", 1, 1))
    if guard is not None:
        guard.warn_if_exceeded("the page")
    return results.write_page(page, _compute_page_params_digest(params))


def _compute_page_params_digest(params: ReportParams) -> str:
    return compute_digest([params.page_size, __version__])


def list_result_names(prepared: PreparedRun) -> list[str]:
    """Return the names that a run will write in the output folder."""
    has_summary = any(stage.is_summary and stage.name in prepared.planned_names for stage in prepared.plan)
    return [
        *(
            name
            for stage in prepared.plan
            if stage.name in prepared.planned_names
            for name in stage.result_names
        ),
        REPORT,
        *([PAGE] if has_summary and prepared.config.report.page else []),
    ]


def check_stages(names: Sequence[str]) -> None:
    """Raise UsageError for an unknown stage name."""
    known = [stage.name for stage in STAGES]
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            raise UsageError(
                CONFIG_PARAMETER_UNKNOWN,
                f"there is no stage {name!r}; "
                + (f"did you mean {near[0]}?" if near else f"known are {', '.join(known)}."),
            )
