"""Engine that runs stages in order, uses cached results, and explains every cache miss.

The engine has no knowledge of specific stages; `scanloom.pipeline.graph` declares them.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Protocol

from scanloom.pipeline.cache.entry import Entry, Recipe
from scanloom.pipeline.cache.store import Cache
from scanloom.pipeline.cache.system import get_peak_bytes, reset_peak_bytes
from scanloom.pipeline.error_conversion import convert_os_errors
from scanloom.pipeline.relative_paths import make_paths_relative
from scanloom.pipeline.run.cache_miss_reason import explain_cache_miss
from scanloom.pipeline.run.events import (
    RunEventHandler,
    RunWaiting,
    StageFinished,
    StageProgress,
    StageStarted,
)
from scanloom.pipeline.run.output_folder import OutputFolder
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import AnyStage, Context
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.surface.memory_release import release_free_memory


@dataclass(frozen=True)
class StageInput:
    """Input of a stage.

    Attributes
    ----------
    digest : content digest.
    value : value passed to the stage.
    parts : digests of the parts, to report which of them changed.
    require_unchanged : raises StageError if the content no longer matches the digest.
    """

    digest: str
    value: Any
    parts: Mapping[str, str]
    require_unchanged: Callable[[], None] = lambda: None


@dataclass(frozen=True)
class StageOutcome:
    """Outcome of a stage in a run.

    Attributes
    ----------
    reason : why the stage ran; empty if cached.
    seconds : time spent in this run.
    compute_cost : cost when the result was computed: `seconds`, and `peak_memory_bytes` of the process.
    folder : folder of the cache entry.
    results : files in the output folder.
    diagnostics : diagnostics emitted when the result was computed.
    """

    stage: str
    cached: bool
    reason: str
    seconds: float
    params: Mapping[str, Any]
    metrics: Mapping[str, Any]
    compute_cost: Mapping[str, Any]
    folder: Path
    results: tuple[Path, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


class ResourceGuard(Protocol):
    """Callbacks that raise StageError when a run exceeds its limits."""

    def check_before(self, stage: str) -> None:
        """Check the limits before a stage is computed."""

    def check_during(self, stage: str, folder: Path, share: float) -> None:
        """Check the limits during a stage.

        `folder` has the files written so far; `share` is the completed ratio of the stage.
        """

    def check_stored(self, stage: str, entry: Entry) -> None:
        """Check the limits after the result of a stage was stored."""


class Engine:
    """Execution of the stages of a plan for one output folder.

    Use as a context manager: inside the block, no other run can use the output folder, and the cache entries
    used by this run cannot be removed.
    """

    def __init__(
        self,
        plan: Sequence[AnyStage],
        config: Sections,
        sources: Mapping[str, StageInput],
        cache: Cache,
        out: Path,
        events: RunEventHandler,
        *,
        overwrite: bool = False,
        scan_folder: Path | None = None,
        megapixels: float | None = None,
        guard: ResourceGuard | None = None,
    ) -> None:
        self._plan = plan
        self._config = config
        self._sources = dict(sources)
        self._cache = cache
        self._out = out
        self._events = events
        self._overwrite = overwrite
        self._scan_folder = scan_folder
        self._megapixels = megapixels
        self._guard = guard
        self._entries: list[Entry] = []

    def __enter__(self) -> Engine:
        text = f"waiting for another run into {self._out}"
        self._lock = self._cache.lock_output_folder(self._out, lambda: self._events(RunWaiting(text)))
        self.output_folder = OutputFolder(self._cache, self._out, overwrite=self._overwrite)
        return self

    def __exit__(self, *exception: object) -> None:
        for entry in self._entries:
            entry.close()
        self._lock.release()

    def run(self, until: str, force: Collection[str]) -> Iterator[StageOutcome]:
        """Run the stages up to `until`, yielding their outcomes; recompute the stages in `force`."""
        last = next(i for i, stage in enumerate(self._plan) if stage.name == until)
        for i, stage in enumerate(self._plan[: last + 1]):
            yield self._run_stage(stage, self._plan[i:], stage.name in force)

    def remove_outdated(self, after: str) -> Entry | None:
        """Remove results of stages after `after` that are no longer valid.

        Returns the entry of the plan's last stage if all results are valid, else None.
        """
        at = next(i for i, stage in enumerate(self._plan) if stage.name == after)
        entry = self._entries[-1] if at + 1 == len(self._plan) else None
        for i in range(at + 1, len(self._plan)):
            entry = self._cache.get(self._make_recipe(self._plan[i]))
            if entry is None:
                self.output_folder.remove_stages(stage.name for stage in self._plan[i:])
                return None
            self._add_result(self._plan[i], entry)
        return entry

    def _run_stage(self, stage: AnyStage, following: Sequence[AnyStage], forced: bool) -> StageOutcome:
        started = time.perf_counter()
        recipe = self._make_recipe(stage)
        entry = None if forced else self._cache.get(recipe)
        cached = entry is not None
        miss_reason = ""
        parts = {name: dict(self._sources[name].parts) for name in list_input_names(stage, self._sources)}
        inputs = {"recipe": recipe.to_json(), "parts": parts}
        if entry is None:
            miss_reason = (
                "forced"
                if forced
                else explain_cache_miss(inputs, self.output_folder.get_recorded_inputs(stage.name))
            )
            if self._guard is not None:
                self._guard.check_before(stage.name)
            self._events(StageStarted(stage.name, miss_reason))
            # Remove the files of this and all later stages: they would not match the new result.
            self.output_folder.remove_stages(stage.name for stage in following)
            entry = self._cache.store(
                recipe, lambda folder: self._compute(stage, folder, forced), replace=forced
            )
            if self._guard is not None:
                self._guard.check_stored(stage.name, entry)
        self._add_result(stage, entry)
        placed = self.output_folder.place_files(stage.name, entry, stage.result_names, inputs)
        seconds = time.perf_counter() - started
        self._events(StageFinished(stage.name, cached, seconds, miss_reason, entry.metrics, placed))
        diagnostics = tuple(one.replace_location_fields(stage=stage.name) for one in entry.diagnostics)
        emit(*diagnostics)
        return StageOutcome(
            stage.name,
            cached,
            miss_reason,
            seconds,
            recipe.params,
            entry.metrics,
            entry.manifest["made"],
            entry.folder,
            placed,
            diagnostics,
        )

    def _make_recipe(self, stage: AnyStage) -> Recipe:
        return make_recipe(stage, self._config, self._sources)

    def _compute(self, stage: AnyStage, folder: Path, forced: bool) -> dict[str, Any]:
        def report_progress(done: int, total: int) -> None:
            if self._guard is not None:
                self._guard.check_during(stage.name, folder, done / max(total, 1))
            self._events(StageProgress(stage.name, done, total))

        inputs = _select_values(stage, self._sources)
        # Otherwise memory left over from earlier stages would count as memory of this one.
        release_free_memory()
        reset_peak_bytes()
        started = time.perf_counter()
        # Diagnostics are emitted after the stage, as for a cached result.
        with convert_os_errors(f"{stage.name} failed"), collecting(forward=False) as diagnostics:
            metrics = stage.run(
                stage.inputs(**{name: value for name, value in inputs.items() if name not in stage.labels}),
                getattr(self._config, stage.name),
                Context(
                    folder,
                    self._config,
                    report_progress,
                    get=partial(self._get_part, forced),
                    store=partial(self._store_part, forced),
                ),
            )
        made = {
            "seconds": round(time.perf_counter() - started, 3),
            "peak_memory_bytes": get_peak_bytes(),
            # Only used to scale time and memory estimates to other scans.
            "megapixels": self._megapixels,
        }
        for name in inputs:
            self._sources[name].require_unchanged()
        record = {"metrics": to_json_values(metrics), "diagnostics": [one.to_dict() for one in diagnostics]}
        return {**make_paths_relative(record, self._scan_folder), "made": made}

    def _get_part(self, forced: bool, recipe: Recipe) -> Entry | None:
        entry = None if forced else self._cache.get(recipe)
        if entry is not None:
            self._hold_entry(entry)
        return entry

    def _store_part(self, forced: bool, recipe: Recipe, make: Callable[[Path], Mapping[str, Any]]) -> Entry:
        entry = self._cache.store(recipe, make, replace=forced)
        self._hold_entry(entry)
        return entry

    def _hold_entry(self, entry: Entry) -> None:
        self._entries.append(entry)
        self.output_folder.record_entry(entry)

    def _add_result(self, stage: AnyStage, entry: Entry) -> None:
        self._hold_entry(entry)
        self._sources[stage.artifact.NAME] = StageInput(
            entry.digest, stage.artifact(entry.folder), entry.files
        )


def make_recipe(stage: AnyStage, config: Sections, sources: Mapping[str, StageInput]) -> Recipe:
    """Compose the recipe of a stage from its known inputs."""
    values = _select_values(stage, sources)
    return Recipe(
        stage.name,
        dict(stage.versions(values, config)),
        params={section: config.to_canonical(section) for section in stage.sections},
        inputs={name: sources[name].digest for name in values},
        libraries=dict(stage.libraries),
    )


def list_input_names(stage: AnyStage, sources: Mapping[str, StageInput]) -> list[str]:
    """Return the names of the inputs a stage reads, known or not yet computed."""
    known = {name: sources[name].value for name in stage.input_names if name in sources}
    return [
        name
        for name in stage.input_names
        if name not in stage.input_conditions or stage.input_conditions[name](known)
    ]


def _select_values(stage: AnyStage, sources: Mapping[str, StageInput]) -> dict[str, Any]:
    return {name: sources[name].value for name in list_input_names(stage, sources) if name in sources}


def to_json_values(value: Any) -> Any:
    """Convert metrics to plain JSON values: NumPy to Python types, non-finite numbers to null."""
    if isinstance(value, Mapping):
        return {str(key): to_json_values(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [to_json_values(item) for item in value]
    if hasattr(value, "tolist"):
        return to_json_values(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
