"""Differences between the outputs of two checkouts, and expected differences."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from outputs.leaves import Leaves

_DIGEST = re.compile(r"\b([0-9a-f]{12})[0-9a-f]{52}\b")
# Last non-numeric part of a dotted name with its indices: `size.0` for `camera.size.0`.
_LAST_PART = re.compile(r".*?([^.]*[^.\d][^.]*(?:\.\d+)*)$")


@dataclass(frozen=True)
class Difference:
    """Leaf that differs between the two checkouts.

    Attributes
    ----------
    kind : "changed", "gone", "new" or "moved".
    where : name of the leaf; "old -> new" if its name changed.
    first, second : its values; empty if missing on that side.
    """

    kind: str
    where: str
    first: str = ""
    second: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.where}"

    @property
    def values(self) -> str:
        """Both values, or the one that exists, with shortened digests."""
        values = dict.fromkeys(value for value in (self.first, self.second) if value)
        return " | ".join(_DIGEST.sub(r"\1", value) for value in values)


@dataclass(frozen=True)
class ExpectedDifference:
    """Expected difference.

    Attributes
    ----------
    job, what : patterns of the job's name and of the difference as text; `*` matches any text.
    reason : shown in the report.
    """

    job: str
    what: str
    reason: str

    def covers(self, job: str, difference: Difference) -> bool:
        """Check if a difference in a job is the expected one."""
        return matches(self.job, job) and matches(self.what, str(difference))


def matches(pattern: str, text: str) -> bool:
    """Check if a pattern matches the whole text; `*` matches any text."""
    return re.fullmatch(".*".join(map(re.escape, pattern.split("*"))), text, re.DOTALL) is not None


def find_differences(first: Leaves, second: Leaves) -> list[Difference]:
    """Compare the leaves of both sides; return differences, files first.

    A value that is gone under one name and new under another counts as moved (equal value) or changed (other
    value). The two names are paired by their last part and value, then by the last part, then by the value,
    if the pairing is unique within a document.
    """
    changed = [name for name in first if name in second and second[name] != first[name]]
    gone = {name for name in first if name not in second}
    new = {name for name in second if name not in first}
    found = [Difference("changed", name, first[name], second[name]) for name in changed]
    for parts in (("last", "value"), ("last",), ("value",)):
        for before, after in _find_unique_pairs(
            _group_names(parts, gone, first), _group_names(parts, new, second)
        ):
            gone.remove(before)
            new.remove(after)
            kind = "moved" if first[before] == second[after] else "changed"
            found.append(Difference(kind, f"{before} -> {after}", first[before], second[after]))
    found += [Difference("gone", name, first[name]) for name in gone]
    found += [Difference("new", name, "", second[name]) for name in new]
    return sorted(found, key=lambda one: (":" in one.where, one.where))


def _find_unique_pairs(
    gone: Mapping[tuple[str, ...], Sequence[str]], new: Mapping[tuple[str, ...], Sequence[str]]
) -> Iterator[tuple[str, str]]:
    """Yield pairs of names whose key is unique on both sides."""
    for key, befores in gone.items():
        afters = new.get(key, ())
        if len(befores) == len(afters) == 1:
            yield befores[0], afters[0]


def _group_names(
    parts: Sequence[str], names: Iterable[str], leaves: Leaves
) -> dict[tuple[str, ...], list[str]]:
    """Group names of document values by document and `parts`.

    Names of files and text lines are left out, because they cannot be paired.

    Parameters
    ----------
    parts : "last" (last part of the name), "value", or both.
    """
    grouped: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name in sorted(names):
        document, colon, place = name.partition(":")
        if colon and not place.startswith(" "):
            known = {"last": _LAST_PART.sub(r"\1", place), "value": leaves[name]}
            grouped[(document, *(known[part] for part in parts))].append(name)
    return grouped
