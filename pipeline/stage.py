"""Declaration of a pipeline stage."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from scanloom.pipeline.cache.entry import Entry, Recipe
from scanloom.pipeline.cost_model import CostModel
from scanloom.pipeline.sections import Sections
from scanloom.stages.progress import Progress
from scanloom.stages.scans.model.scan import Scan

Inputs = TypeVar("Inputs")
Params = TypeVar("Params")


@dataclass(frozen=True)
class Context:
    """Execution context of a stage.

    Attributes
    ----------
    folder : empty folder for the files of the stage.
    config : full configuration; results may only depend on the sections that the stage declares.
    progress : progress callback.
    get, store : cache access for intermediate results; their entries are kept until the end of the run.
    """

    folder: Path
    config: Sections
    progress: Progress
    get: Callable[[Recipe], Entry | None]
    store: Callable[[Recipe, Callable[[Path], Mapping[str, Any]]], Entry]


@dataclass(frozen=True)
class Artifact:
    """Files written by a stage. A subclass names and loads their content.

    Attributes
    ----------
    NAME : name of the content in the graph, the cache and reports.
    folder : folder of the files.
    """

    NAME: ClassVar[str]
    folder: Path


def _skip_never(scan: Any, config: Any) -> str | None:  # noqa: ARG001
    return None


def _allow_any_memory(config: Any) -> float:  # noqa: ARG001
    return math.inf


def _ignore_no_inputs(config: Any) -> Collection[str]:  # noqa: ARG001
    return ()


@dataclass(frozen=True, kw_only=True)
class Stage(Generic[Inputs, Params]):
    """Declaration of a stage.

    Attributes
    ----------
    name : name in messages, and of the configuration section with the parameters.
    section : class of the parameters.
    inputs : dataclass of inputs; each field is named after a source of the run or an artifact. Fields with a
        default are optional.
    artifact : class of the artifact.
    run : writes the files of the artifact and returns metrics. Emitted diagnostics are stored with the
        result.
    versions : function of known inputs and configuration that returns the RESULT_VERSION of all code that
        `run` executes, by name. It is called for every cache key.
    libraries : versions of distributions that affect the result, by name.
    labels : inputs without a value that only enter the cache key, such as frame names.
    extra_sections : further configuration sections that affect the result.
    result_names : files copied to the output folder; names of folders end in /.
    input_conditions : condition for reading an input, by input name, as a function of the other inputs.
    ignored_inputs : function of the configuration that returns the names of ignored inputs.
    skip_reason : function of scan and configuration that returns why the stage is skipped, or None. The text
        continues a sentence that begins with the stage name.
    cost : cost model for the first run.
    headline : format string for the summary line of a result, or a function of the metrics that returns the
        format string. Fields are metrics.
    progress_unit : unit counted by the progress callback.
    is_summary : True if the metrics summarise the run: report.json has them at the top level, and the page is
        written with this stage.
    memory_bound : function of the configuration that returns the maximum memory of the stage in bytes.
    input_names : names of the inputs and labels.
    """

    name: str
    section: type[Params]
    inputs: type[Inputs]
    artifact: type[Artifact]
    run: Callable[[Inputs, Params, Context], Mapping[str, Any]]
    versions: Callable[[Mapping[str, Any], Any], Mapping[str, int]]
    libraries: Mapping[str, str] = field(default_factory=dict)
    labels: tuple[str, ...] = ()
    extra_sections: tuple[str, ...] = ()
    result_names: tuple[str, ...] = ()
    input_conditions: Mapping[str, Callable[[Mapping[str, Any]], bool]] = field(default_factory=dict)
    ignored_inputs: Callable[[Any], Collection[str]] = _ignore_no_inputs
    skip_reason: Callable[[Scan, Any], str | None] = _skip_never
    cost: CostModel = field(default_factory=CostModel)
    headline: str | Callable[[Mapping[str, Any]], str] = ""
    progress_unit: str = "steps"
    is_summary: bool = False
    memory_bound: Callable[[Any], float] = _allow_any_memory
    input_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.input_names:
            names = (one.name for one in fields(self.inputs))  # type: ignore[arg-type]
            object.__setattr__(self, "input_names", (*names, *self.labels))

    @property
    def sections(self) -> tuple[str, ...]:
        """Configuration sections that affect the result."""
        return (self.name, *self.extra_sections)


# Stage with unspecified input and parameter types.
AnyStage = Stage[Any, Any]
