"""Declaration of a stage: what the pipeline knows about it."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from scanloom.pipeline.cache.entry import Entry, Recipe
from scanloom.pipeline.expectation import Cost
from scanloom.pipeline.sections import Sections
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Scan

Inputs = TypeVar("Inputs")
Params = TypeVar("Params")


@dataclass(frozen=True)
class Context:
    """Context of a stage: its folder, the configuration, progress and the cache.

    Attributes
    ----------
    folder : empty folder for the files of the stage.
    config : all sections; results may depend on the sections that the stage declares, and no others.
    progress : progress callback.
    get, store : of the cache, for parts of the stage's work; their entries are held to the end of the run.
    """

    folder: Path
    config: Sections
    progress: Progress
    get: Callable[[Recipe], Entry | None]
    store: Callable[[Recipe, Callable[[Path], Mapping[str, Any]]], Entry]


@dataclass(frozen=True)
class Artifact:
    """Files that a stage has written. A subclass names their content and loads it.

    Attributes
    ----------
    NAME : name of the content, the same in the graph, in the cache and in documents.
    """

    NAME: ClassVar[str]
    folder: Path


def _never_skipped(scan: Any, config: Any) -> str | None:  # noqa: ARG001
    return None


def _no_bound(config: Any) -> float:  # noqa: ARG001
    return math.inf


def _reads_all(config: Any) -> Collection[str]:  # noqa: ARG001
    return ()


@dataclass(frozen=True, kw_only=True)
class Stage(Generic[Inputs, Params]):
    """Everything the pipeline knows about a stage.

    Attributes
    ----------
    name : for people; also the section of the configuration with its parameters.
    section : class of the parameters.
    inputs : dataclass; each field is named after a source of the run or an artifact. A field with a default
        may be missing.
    writes : class of the artifact.
    run : writes the files of the artifact and returns figures. What it emits is kept with the result.
    versions : from known inputs and configuration to the RESULT_VERSION of all code that `run` then uses, by
        name. It is called for every cache key.
    libraries : versions of distributions that decide the result, by name.
    labels : sources without a value that decide the result, such as names of frames.
    more_sections : further sections of the configuration that decide the result.
    results : files that are copied to the output folder; a name that ends in / is a folder.
    when : conditions on the other inputs, by the input that is only read if they hold.
    unread : inputs that are not read with a configuration.
    skip_reason : from scan and configuration to the reason why the stage is skipped, or None. The text
        continues a sentence that begins with the name of the stage.
    cost : estimate for the first run.
    headline : format of the line that sums up a result, or a function from figures to it. Fields are figures.
    progress_unit : what the progress callback counts.
    is_summary : its figures sum up the run: report.json has them at the top, and the page belongs to it.
    memory_bound : from the configuration to the bytes that the stage keeps to.
    reads : names of the inputs and labels.
    """

    name: str
    section: type[Params]
    inputs: type[Inputs]
    writes: type[Artifact]
    run: Callable[[Inputs, Params, Context], Mapping[str, Any]]
    versions: Callable[[Mapping[str, Any], Any], Mapping[str, int]]
    libraries: Mapping[str, str] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    more_sections: tuple[str, ...] = ()
    results: tuple[str, ...] = ()
    when: Mapping[str, Callable[[Mapping[str, Any]], bool]] = field(default_factory=dict)
    unread: Callable[[Any], Collection[str]] = _reads_all
    skip_reason: Callable[[Scan, Any], str | None] = _never_skipped
    cost: Cost = field(default_factory=Cost)
    headline: str | Callable[[Mapping[str, Any]], str] = ""
    progress_unit: str = "steps"
    is_summary: bool = False
    memory_bound: Callable[[Any], float] = _no_bound
    reads: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.reads:
            names = (one.name for one in fields(self.inputs))  # type: ignore[arg-type]
            object.__setattr__(self, "reads", (*names, *self.labels))

    @property
    def sections(self) -> tuple[str, ...]:
        """Return the sections of the configuration that decide the result."""
        return (self.name, *self.more_sections)


# A stage whose inputs and parameters the code at hand does not look into.
AnyStage = Stage[Any, Any]
