"""Versions of the code that determines a result, for cache keys."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from typing import Any

from scanloom.pipeline.sections import Sections

VersionsFunction = Callable[[Mapping[str, Any], Sections], Mapping[str, int]]


def collect_result_versions(*functions: Callable[..., Any]) -> dict[str, int]:
    """Return the RESULT_VERSION of the module of each function, by module name."""
    modules = [sys.modules[function.__module__] for function in functions]
    return {module.__name__.rpartition(".")[2]: module.RESULT_VERSION for module in modules}


def make_fixed_versions(*functions: Callable[..., Any]) -> VersionsFunction:
    """Create the `versions` of a stage that runs the same functions in every configuration."""
    return lambda known, config: collect_result_versions(*functions)  # noqa: ARG005
