"""Dry run: predicts a run without writing, not even a lock."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.pipeline.cache.digest import digest
from scanloom.pipeline.cache.entry import DamagedError, Recipe, verified
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.config import Config
from scanloom.pipeline.expectation import Expectation, expected, megapixels
from scanloom.pipeline.run.engine import Source, read_by, recipe_of
from scanloom.pipeline.run.reasons import reason
from scanloom.pipeline.run.results import Results
from scanloom.pipeline.run.run import Wanted, cache_folder, placed_by, wanted_of
from scanloom.pipeline.run.sources import sources_of
from scanloom.pipeline.stage import AnyStage
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED


@dataclass(frozen=True)
class Foreseen:
    """Prediction for a stage.

    Attributes
    ----------
    reason : why the stage would run; empty if its result is cached.
    expected : expected cost; None if the result is cached.
    """

    stage: str
    cached: bool
    reason: str
    expected: Expectation | None

    def figures(self) -> dict[str, Any]:
        """Return the prediction as JSON values."""
        take = self.expected
        return {
            "cached": self.cached,
            "reason": self.reason,
            "expected_seconds": None if take is None else round(take.seconds, 1),
            "expected_memory_mb": None if take is None else round(take.memory_bytes / 1e6),
            "expected_from": None if take is None else take.basis,
        }


@dataclass(frozen=True)
class DryRun:
    """Predictions for a run.

    Attributes
    ----------
    refused : reason why the run would not start: a file in the output folder that it must not replace. None
        otherwise.
    """

    out: Path
    cache: Path
    layout: str
    frames: int
    stages: tuple[Foreseen, ...]
    refused: str | None
    diagnostics: tuple[Diagnostic, ...]

    @property
    def seconds(self) -> float:
        """Expected seconds of all stages."""
        return sum(one.expected.seconds for one in self.stages if one.expected is not None)

    @property
    def memory_bytes(self) -> int:
        """Expected peak memory in bytes over all stages."""
        return max((one.expected.memory_bytes for one in self.stages if one.expected is not None), default=0)

    def figures(self) -> dict[str, Any]:
        """Return the predictions as JSON values."""
        return {
            "dry_run": True,
            "out": str(self.out),
            "cache": str(self.cache),
            "scan": {"layout": self.layout, "frames": self.frames},
            "stages": {one.stage: one.figures() for one in self.stages},
            "expected_seconds": round(self.seconds, 1),
            "expected_memory_mb": round(self.memory_bytes / 1e6),
            "refused": self.refused,
        }


def foresee(
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
    cache = Cache(cache_folder(Path(out).resolve(), cache_dir))
    wanted = wanted_of(scan_folder, out, config or Config(), until, force, cache)
    results = Results(cache, wanted.out, overwrite=overwrite)
    refused = None
    try:
        results.require_replaceable(placed_by(wanted))
    except InputError as error:
        refused = str(error)
    with collecting() as diagnostics:
        if refused is not None:
            emit(FILE_OUTPUT_REFUSED.warning("the run would not start: {reason}", reason=refused))
    return DryRun(
        out=wanted.out,
        cache=cache.folder,
        layout=wanted.scan.layout,
        frames=len(wanted.scan.frames),
        stages=_foreseen(wanted, cache, results),
        refused=refused,
        diagnostics=(*wanted.diagnostics, *diagnostics),
    )


def _foreseen(wanted: Wanted, cache: Cache, results: Results) -> tuple[Foreseen, ...]:
    scan, size = wanted.scan, megapixels(wanted.scan)
    sources = sources_of(scan, wanted.config, wanted.photos)
    writers = {stage.writes.NAME: stage.name for stage in wanted.plan}
    entries = sorted(cache.ls(), key=lambda entry: -entry.last_used.timestamp())
    earlier = [entry.manifest for entry in entries if entry.problem is None]
    found = []
    for stage in wanted.plan[: len(wanted.planned)]:
        recipe = recipe_of(stage, wanted.config, sources)
        read = read_by(stage, sources)
        open_inputs = [name for name in read if name not in sources]
        last = results.decided(stage.name)
        manifest, why = None, ""
        if open_inputs:
            why = _awaiting([writers[name] for name in open_inputs], recipe, last)
        else:
            parts = {name: dict(sources[name].parts) for name in read}
            manifest, why = _looked_up(cache, recipe, {"recipe": recipe.as_json(), "parts": parts}, last)
        if stage.name in wanted.force:
            manifest, why = None, "forced"
        if manifest is not None:
            sources[stage.writes.NAME] = _source(stage, cache.folder / stage.name / recipe.key, manifest)
            found.append(Foreseen(stage.name, True, "", None))
            continue
        inputs = None if open_inputs else recipe.inputs
        take = expected(stage.name, size, inputs, earlier, stage.cost)
        found.append(Foreseen(stage.name, False, why, take))
    return tuple(found)


def _looked_up(
    cache: Cache, recipe: Recipe, now: Mapping[str, Any], last: Mapping[str, Any] | None
) -> tuple[Mapping[str, Any] | None, str]:
    """Look up a valid cached result.

    Returns its manifest and "", or None and the reason to run the stage.
    """
    place = cache.folder / recipe.stage / recipe.key
    if not place.is_dir():
        return None, reason(now, last)
    try:
        return verified(place), ""
    except DamagedError as error:
        return None, f"cached result damaged: {error}"


def _awaiting(before: Sequence[str], recipe: Recipe, last: Mapping[str, Any] | None) -> str:
    """Explain why a stage would run after stages that run."""
    if last is None:
        return "first run"
    unchanged = {"recipe": {**recipe.as_json(), "inputs": last["recipe"]["inputs"]}, "parts": last["parts"]}
    deciding = ("versions", "params", "libraries")
    is_changed = any(unchanged["recipe"][name] != last["recipe"].get(name) for name in deciding)
    names = list(dict.fromkeys(before))
    follows = f"follows {', '.join(names)}, which run{'s' * (len(names) == 1)}"
    return f"{reason(unchanged, last)}; {follows}" if is_changed else follows


def _source(stage: AnyStage, place: Path, manifest: Mapping[str, Any]) -> Source:
    files = {name: about["sha256"] for name, about in manifest["files"].items()}
    return Source(digest(files), stage.writes(place), files)
