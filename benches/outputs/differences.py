"""Where two sides differ, leaf by leaf, and which differences are meant."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from outputs.leaves import Leaves

_DIGEST = re.compile(r"\b([0-9a-f]{12})[0-9a-f]{52}\b")
# The last part of a name that is no number, with the numbers behind it: it is `size.0` of `camera.size.0`.
_LAST = re.compile(r".*?([^.]*[^.\d][^.]*(?:\.\d+)*)$")


@dataclass(frozen=True)
class Difference:
    """One leaf that is not the same on both sides; `kind` is changed, gone, new or moved."""

    kind: str
    where: str
    first: str = ""
    second: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.where}"

    @property
    def values(self) -> str:
        """Return the values of both sides, or of the one that has it, digests shortened."""
        values = dict.fromkeys(value for value in (self.first, self.second) if value)
        return " | ".join(_DIGEST.sub(r"\1", value) for value in values)


@dataclass(frozen=True)
class Expected:
    """A difference that is meant; `*` in `job` and `what` stands for any text."""

    job: str
    what: str
    reason: str

    def covers(self, job: str, difference: Difference) -> bool:
        """Return whether this is the difference that is meant, in the job it is meant for."""
        return matches(self.job, job) and matches(self.what, str(difference))


def matches(pattern: str, text: str) -> bool:
    """Return whether the whole text fits the pattern, where `*` stands for any text."""
    return re.fullmatch(".*".join(map(re.escape, pattern.split("*"))), text, re.DOTALL) is not None


def differences(first: Leaves, second: Leaves) -> list[Difference]:
    """Return where two sides differ, files before values in documents.

    A value of a document that is gone from one place and new in another is told as moved, or as changed if
    it is another one: when the last part of the name is the same, or else the value, and no other that is
    gone or new there has the same.
    """
    changed = [name for name in first if name in second and second[name] != first[name]]
    gone = {name for name in first if name not in second}
    new = {name for name in second if name not in first}
    found = [Difference("changed", name, first[name], second[name]) for name in changed]
    for parts in (("last", "value"), ("last",), ("value",)):
        for before, after in _pairs(_by(parts, gone, first), _by(parts, new, second)):
            gone.remove(before)
            new.remove(after)
            kind = "moved" if first[before] == second[after] else "changed"
            found.append(Difference(kind, f"{before} -> {after}", first[before], second[after]))
    found += [Difference("gone", name, first[name]) for name in gone]
    found += [Difference("new", name, "", second[name]) for name in new]
    return sorted(found, key=lambda one: (":" in one.where, one.where))


def _pairs(
    gone: Mapping[tuple[str, ...], Sequence[str]], new: Mapping[tuple[str, ...], Sequence[str]]
) -> Iterator[tuple[str, str]]:
    """Yield the names that alone have a key, on both sides."""
    for key, befores in gone.items():
        afters = new.get(key, ())
        if len(befores) == len(afters) == 1:
            yield befores[0], afters[0]


def _by(parts: Sequence[str], names: Iterable[str], leaves: Leaves) -> dict[tuple[str, ...], list[str]]:
    """Return the names in documents by document and what is asked for: last part of the name, value, both.

    Files and lines of text have no name but their own.
    """
    grouped: dict[tuple[str, ...], list[str]] = defaultdict(list)
    for name in sorted(names):
        document, colon, place = name.partition(":")
        if colon and not place.startswith(" "):
            known = {"last": _LAST.sub(r"\1", place), "value": leaves[name]}
            grouped[(document, *(known[part] for part in parts))].append(name)
    return grouped
