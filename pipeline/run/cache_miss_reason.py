"""Explanation of cache misses by comparing recipes of this and the latest run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from scanloom.stages.params import flatten

_MISSING = object()


def explain_cache_miss(now: Mapping[str, Any], last: Mapping[str, Any] | None) -> str:
    """Explain in a few words what changed since the latest run.

    Parameters
    ----------
    now, last : `recipe` (see scanloom.pipeline.cache.entry.Recipe) and `parts`, the digests of the parts of
        each input by input name. `last` is None if the latest run did not reach this stage.
    """
    if last is None:
        return "first run"
    recipe, before = now["recipe"], last["recipe"]
    params = [
        *_describe_changes(
            "params changed:", _flatten_params(before["params"]), _flatten_params(recipe["params"])
        )
    ]
    changes = [
        *_describe_version_changes(before, recipe, only_common=bool(params)),
        *_describe_changes("library changed:", before["libraries"], recipe["libraries"]),
        *params,
        *_describe_input_changes(last["parts"], now["parts"]),
    ]
    return "; ".join(changes) or "no longer in the cache"


def _describe_changes(what: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> Iterator[str]:
    names = [name for name in {**now, **before} if before.get(name, _MISSING) != now.get(name, _MISSING)]
    if names:
        each = [f"{name} {_format_value(before, name)} → {_format_value(now, name)}" for name in names]
        yield f"{what} {', '.join(each)}"


def _describe_version_changes(
    before: Mapping[str, Any], now: Mapping[str, Any], *, only_common: bool
) -> Iterator[str]:
    # Records of earlier program versions have no code versions.
    old, new = before.get("versions", {}), now["versions"]
    # Changed parameters may add or remove modules; only a changed version of a common module is a separate
    # reason.
    names = [name for name in (*new, *old) if name in old.keys() & new.keys() or not only_common]
    yield from _describe_changes(
        "stage changed:",
        *({f"version of {name}": one[name] for name in names if name in one} for one in (old, new)),
    )


def _flatten_params(params: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    # Sections may share parameter names, so prefix the section if there are several.
    several = len(params) > 1
    return {
        f"{section}.{name}" if several else name: value
        for section, values in params.items()
        for name, value in flatten(values).items()
    }


def _format_value(values: Mapping[str, Any], name: str) -> str:
    # An older version of the program may not have had the parameter.
    value = values.get(name, "unknown")
    return "not set" if value is None else f"{value:g}" if isinstance(value, float) else str(value)


def _describe_input_changes(
    before: Mapping[str, Mapping[str, str]], now: Mapping[str, Mapping[str, str]]
) -> Iterator[str]:
    old = {part: content for parts in before.values() for part, content in parts.items()}
    new = {part: content for parts in now.values() for part, content in parts.items()}
    names = [part for part in {**new, **old} if old.get(part) != new.get(part)]
    if names:
        more = f" and {len(names) - 1} more" if len(names) > 1 else ""
        yield f"input changed: {names[0]}{more}"
