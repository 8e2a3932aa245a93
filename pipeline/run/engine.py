"""Run stages in order, each from the cache if it can be, and say why when it cannot.

The engine knows no stage by name; `scanloom.pipeline.graph` declares them.
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
from scanloom.pipeline.cache.system import peak_bytes, reset_peak
from scanloom.pipeline.failures import explained
from scanloom.pipeline.own_paths import from_folder
from scanloom.pipeline.run.events import Events, StageFinished, StageProgress, StageStarted, Waiting
from scanloom.pipeline.run.reasons import reason
from scanloom.pipeline.run.results import Results
from scanloom.pipeline.sections import Sections
from scanloom.pipeline.stage import AnyStage, Context
from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.diagnostic import Diagnostic
from scanloom.stages.surface.memory import give_back


@dataclass(frozen=True)
class Source:
    """Something a stage reads.

    Attributes
    ----------
    digest : of its content.
    value : what the stage is given.
    parts : digests of its parts, to say which of them changed.
    require_unchanged : raises StageError if the content is not any more what the digest was taken of.
    """

    digest: str
    value: Any
    parts: Mapping[str, str]
    require_unchanged: Callable[[], None] = lambda: None


@dataclass(frozen=True)
class Outcome:
    """What became of one stage.

    Attributes
    ----------
    seconds : spent in this run.
    made : when the result was made: `seconds`, and the peak memory of the process in `peak_memory_bytes`.
    folder : the cache entry.
    diagnostics : what the stage emitted when the result was made.
    """

    stage: str
    cached: bool
    reason: str
    seconds: float
    params: Mapping[str, Any]
    figures: Mapping[str, Any]
    made: Mapping[str, Any]
    folder: Path
    results: tuple[Path, ...]
    diagnostics: tuple[Diagnostic, ...] = ()


class Guard(Protocol):
    """Ends a run that takes more than it may, by raising StageError."""

    def before(self, stage: str) -> None:
        """Look before a stage works."""

    def during(self, stage: str, folder: Path, share: float) -> None:
        """Look while it works, at the files it has written so far too; `share` of its work is done."""

    def kept(self, stage: str, entry: Entry) -> None:
        """Look at what it left."""


class Engine:
    """One run: the stages of a plan, over the sources, into an output folder.

    Use it in a `with` block: until its end, no other run works into the folder, and nobody removes the cache
    entries this one has met.
    """

    def __init__(
        self,
        plan: Sequence[AnyStage],
        config: Sections,
        sources: Mapping[str, Source],
        cache: Cache,
        out: Path,
        events: Events,
        *,
        overwrite: bool = False,
        scan_folder: Path | None = None,
        megapixels: float | None = None,
        guard: Guard | None = None,
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
        said = f"another run is working into {self._out}; this one waits for it"
        self._lock = self._cache.sole_run(self._out, lambda: self._events(Waiting(said)))
        self.results = Results(self._cache, self._out, overwrite=self._overwrite)
        return self

    def __exit__(self, *exception: object) -> None:
        for entry in self._entries:
            entry.close()
        self._lock.release()

    def run(self, until: str, force: Collection[str]) -> Iterator[Outcome]:
        """Run the stages up to and with `until`, one a step; those in `force` without asking the cache."""
        last = next(i for i, stage in enumerate(self._plan) if stage.name == until)
        for i, stage in enumerate(self._plan[: last + 1]):
            yield self._run_stage(stage, self._plan[i:], stage.name in force)

    def withdraw_outdated(self, after: str) -> Entry | None:
        """Remove results of later stages that do not follow from what is there now.

        Returns the entry of the plan's last stage if everything up to it is still valid.
        """
        at = next(i for i, stage in enumerate(self._plan) if stage.name == after)
        entry = self._entries[-1] if at + 1 == len(self._plan) else None
        for i in range(at + 1, len(self._plan)):
            entry = self._cache.get(self._recipe(self._plan[i]))
            if entry is None:
                self.results.withdraw(stage.name for stage in self._plan[i:])
                return None
            self._add(self._plan[i], entry)
        return entry

    def _run_stage(self, stage: AnyStage, following: Sequence[AnyStage], forced: bool) -> Outcome:
        started = time.perf_counter()
        recipe = self._recipe(stage)
        entry = None if forced else self._cache.get(recipe)
        cached = entry is not None
        why = ""
        parts = {name: dict(self._sources[name].parts) for name in read_by(stage, self._sources)}
        decided = {"recipe": recipe.as_json(), "parts": parts}
        if entry is None:
            why = "forced" if forced else reason(decided, self.results.decided(stage.name))
            if self._guard is not None:
                self._guard.before(stage.name)
            self._events(StageStarted(stage.name, why))
            # Files of this stage and the later ones belong to another run from here on.
            self.results.withdraw(stage.name for stage in following)
            entry = self._cache.store(
                recipe, lambda folder: self._make(stage, folder, forced), replace=forced
            )
            if self._guard is not None:
                self._guard.kept(stage.name, entry)
        self._add(stage, entry)
        placed = self.results.place(stage.name, entry, stage.results, decided)
        seconds = time.perf_counter() - started
        self._events(StageFinished(stage.name, cached, seconds, why, entry.figures, placed))
        diagnostics = tuple(one.within(stage=stage.name) for one in entry.diagnostics)
        emit(*diagnostics)
        return Outcome(
            stage.name,
            cached,
            why,
            seconds,
            recipe.params,
            entry.figures,
            entry.manifest["made"],
            entry.folder,
            placed,
            diagnostics,
        )

    def _recipe(self, stage: AnyStage) -> Recipe:
        return recipe_of(stage, self._config, self._sources)

    def _make(self, stage: AnyStage, folder: Path, forced: bool) -> dict[str, Any]:
        def progress(done: int, total: int) -> None:
            if self._guard is not None:
                self._guard.during(stage.name, folder, done / max(total, 1))
            self._events(StageProgress(stage.name, done, total))

        inputs = _values(stage, self._sources)
        # What other stages have left would count as this one's.
        give_back()
        reset_peak()
        started = time.perf_counter()
        # They are emitted when the stage has ended, as they are where its result is cached.
        with explained(f"{stage.name} failed"), collecting(forward=False) as diagnostics:
            figures = stage.run(
                stage.inputs(**{name: value for name, value in inputs.items() if name not in stage.labels}),
                getattr(self._config, stage.name),
                Context(
                    folder,
                    self._config,
                    progress,
                    get=partial(self._get_part, forced),
                    store=partial(self._store_part, forced),
                ),
            )
        made = {
            "seconds": round(time.perf_counter() - started, 3),
            "peak_memory_bytes": peak_bytes(),
            # It decides nothing; a later run on another scan takes as much longer as that is larger.
            "megapixels": self._megapixels,
        }
        for name in inputs:
            self._sources[name].require_unchanged()
        told = {"figures": as_json(figures), "diagnostics": [one.figures() for one in diagnostics]}
        return {**from_folder(told, self._scan_folder), "made": made}

    def _get_part(self, forced: bool, recipe: Recipe) -> Entry | None:
        entry = None if forced else self._cache.get(recipe)
        if entry is not None:
            self._hold(entry)
        return entry

    def _store_part(self, forced: bool, recipe: Recipe, make: Callable[[Path], Mapping[str, Any]]) -> Entry:
        entry = self._cache.store(recipe, make, replace=forced)
        self._hold(entry)
        return entry

    def _hold(self, entry: Entry) -> None:
        self._entries.append(entry)
        self.results.keep(entry)

    def _add(self, stage: AnyStage, entry: Entry) -> None:
        self._hold(entry)
        self._sources[stage.writes.NAME] = Source(entry.digest, stage.writes(entry.folder), entry.files)


def recipe_of(stage: AnyStage, config: Sections, sources: Mapping[str, Source]) -> Recipe:
    """Return all that decides a stage's result; sources that are not known are left out of it."""
    values = _values(stage, sources)
    return Recipe(
        stage.name,
        dict(stage.versions(values, config)),
        params={section: config.canonical(section) for section in stage.sections},
        inputs={name: sources[name].digest for name in values},
        libraries=dict(stage.libraries),
    )


def read_by(stage: AnyStage, sources: Mapping[str, Source]) -> list[str]:
    """Return the names of what a stage reads of these sources, whether they are known already or not."""
    known = {name: sources[name].value for name in stage.reads if name in sources}
    return [name for name in stage.reads if name not in stage.when or stage.when[name](known)]


def _values(stage: AnyStage, sources: Mapping[str, Source]) -> dict[str, Any]:
    return {name: sources[name].value for name in read_by(stage, sources) if name in sources}


def as_json(value: Any) -> Any:
    """Return figures as plain JSON values: Python's own numbers, null for what is not finite."""
    if isinstance(value, Mapping):
        return {str(key): as_json(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_json(item) for item in value]
    if hasattr(value, "tolist"):
        return as_json(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
