"""Dry run: predicts a run without writing, not even a lock."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import compute_digest
from scanloom.pipeline.cache.entry import DamagedEntryError, Recipe, verify_entry
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.cost_model import ResourceEstimate, count_megapixels, estimate_cost
from scanloom.pipeline.run.cache_miss_reason import explain_cache_miss
from scanloom.pipeline.run.engine import StageInput, list_input_names, make_recipe
from scanloom.pipeline.run.output_folder import OutputFolder
from scanloom.pipeline.run.run import PreparedRun, get_cache_folder, list_result_names, prepare_run
from scanloom.pipeline.run.sources import load_sources
from scanloom.pipeline.stage import AnyStage
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.path_safety import resolve_path


@dataclass(frozen=True)
class StageForecast:
    """Prediction for a stage.

    Attributes
    ----------
    reason : why the stage would run; empty if its result is cached.
    estimate : expected cost; None if the result is cached.
    """

    stage: str
    cached: bool
    reason: str
    estimate: ResourceEstimate | None

    def to_dict(self) -> dict[str, Any]:
        """Return the prediction as JSON values."""
        estimate = self.estimate
        return {
            "cached": self.cached,
            "reason": self.reason,
            "expected_seconds": None if estimate is None else round(estimate.seconds, 1),
            "expected_memory_mb": None if estimate is None else round(estimate.memory_bytes / 1e6),
            "estimate_basis": None if estimate is None else estimate.basis,
        }


@dataclass(frozen=True)
class DryRun:
    """Predictions for a run.

    Attributes
    ----------
    refusal_reason : reason why the run would not start: a file in the output folder that it must not replace.
        None
        otherwise.
    """

    out: Path
    cache: Path
    layout: str
    frames: int
    stages: tuple[StageForecast, ...]
    refusal_reason: str | None
    diagnostics: tuple[Diagnostic, ...]

    @property
    def seconds(self) -> float:
        """Expected seconds of all stages."""
        return sum(one.estimate.seconds for one in self.stages if one.estimate is not None)

    @property
    def memory_bytes(self) -> int:
        """Expected peak memory in bytes over all stages."""
        return max((one.estimate.memory_bytes for one in self.stages if one.estimate is not None), default=0)

    def to_dict(self) -> dict[str, Any]:
        """Return the predictions as JSON values."""
        return {
            "dry_run": True,
            "out": str(self.out),
            "cache": str(self.cache),
            "scan": {"layout": self.layout, "frames": self.frames},
            "stages": {one.stage: one.to_dict() for one in self.stages},
            "expected_seconds": round(self.seconds, 1),
            "expected_memory_mb": round(self.memory_bytes / 1e6),
            "refused": self.refusal_reason,
        }


def predict_run(
    scan_folder: Path | str,
    out: Path | str,
    config: Config | None = None,
    *,
    until: str | None = None,
    force: Collection[str] = (),
    cache_dir: Path | str | None = None,
    overwrite: bool = False,
) -> DryRun:
    """Predict what `scanloom.pipeline.run.run.run` would do with the same arguments, without writing.

    All stages after a stage that runs are predicted to run. They may turn out to be cached, if the new result
    equals an earlier one.

    Raises
    ------
    InputError, UsageError
        As `scanloom.pipeline.run.run.run`, except that a file which must not be replaced only causes a
        warning.
    """
    cache = Cache(get_cache_folder(resolve_path(out), cache_dir))
    prepared = prepare_run(scan_folder, out, config or Config(), until, force, cache)
    results = OutputFolder(cache, prepared.out, overwrite=overwrite)
    refusal_reason = None
    try:
        results.check_replaceable(list_result_names(prepared))
    except InputError as error:
        refusal_reason = str(error)
    with collecting() as diagnostics:
        if refusal_reason is not None:
            emit(FILE_OUTPUT_REFUSED.warning("the run would not start: {reason}", reason=refusal_reason))
    return DryRun(
        out=prepared.out,
        cache=cache.folder,
        layout=prepared.scan.layout,
        frames=len(prepared.scan.frames),
        stages=_predict_stages(prepared, cache, results),
        refusal_reason=refusal_reason,
        diagnostics=(*prepared.diagnostics, *diagnostics),
    )


def _predict_stages(prepared: PreparedRun, cache: Cache, results: OutputFolder) -> tuple[StageForecast, ...]:
    scan, size = prepared.scan, count_megapixels(prepared.scan)
    sources = load_sources(scan, prepared.config, prepared.photos)
    writers = {stage.artifact.NAME: stage.name for stage in prepared.plan}
    entries = sorted(cache.ls(), key=lambda entry: -entry.last_used.timestamp())
    earlier = [entry.manifest for entry in entries if entry.problem is None]
    found = []
    for stage in prepared.plan[: len(prepared.planned_names)]:
        recipe = make_recipe(stage, prepared.config, sources)
        read = list_input_names(stage, sources)
        open_inputs = [name for name in read if name not in sources]
        last = results.get_recorded_inputs(stage.name)
        manifest, why = None, ""
        if open_inputs:
            why = _explain_pending([writers[name] for name in open_inputs], recipe, last)
        else:
            parts = {name: dict(sources[name].parts) for name in read}
            manifest, why = _look_up(cache, recipe, {"recipe": recipe.to_json(), "parts": parts}, last)
        if stage.name in prepared.force:
            manifest, why = None, "forced"
        if manifest is not None:
            sources[stage.artifact.NAME] = _make_source(
                stage, cache.folder / stage.name / recipe.key, manifest
            )
            found.append(StageForecast(stage.name, True, "", None))
            continue
        inputs = None if open_inputs else recipe.inputs
        estimate = estimate_cost(stage.name, size, inputs, earlier, stage.cost)
        found.append(StageForecast(stage.name, False, why, estimate))
    return tuple(found)


def _look_up(
    cache: Cache, recipe: Recipe, now: Mapping[str, Any], last: Mapping[str, Any] | None
) -> tuple[Mapping[str, Any] | None, str]:
    """Look up a valid cached result.

    Returns its manifest and "", or None and the reason to run the stage.
    """
    place = cache.folder / recipe.stage / recipe.key
    if not place.is_dir():
        return None, explain_cache_miss(now, last)
    try:
        return verify_entry(place), ""
    except DamagedEntryError as error:
        return None, f"cached result damaged: {error}"


def _explain_pending(running: Sequence[str], recipe: Recipe, last: Mapping[str, Any] | None) -> str:
    """Explain why a stage would run after stages that run."""
    if last is None:
        return "first run"
    unchanged = {"recipe": {**recipe.to_json(), "inputs": last["recipe"]["inputs"]}, "parts": last["parts"]}
    deciding = ("versions", "params", "libraries")
    is_changed = any(unchanged["recipe"][name] != last["recipe"].get(name) for name in deciding)
    names = list(dict.fromkeys(running))
    follows = f"follows {', '.join(names)}, which run{'s' * (len(names) == 1)}"
    return f"{explain_cache_miss(unchanged, last)}; {follows}" if is_changed else follows


def _make_source(stage: AnyStage, place: Path, manifest: Mapping[str, Any]) -> StageInput:
    files = {name: about["sha256"] for name, about in manifest["files"].items()}
    return StageInput(compute_digest(files), stage.artifact(place), files)
