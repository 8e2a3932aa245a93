"""What a job left behind as leaves, each a name and a value, and where two sides differ.

A leaf is a file and the digest of its bytes, a member of an archive, a value in a JSON document, or a line of
text. What is different in each run has no leaf: seconds, dates, memory, keys of the cache.
"""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

Leaves = dict[str, str]

# Keys of JSON whose values belong to one run.
VOLATILE = {"created", "last_used", "made_in_s", "peak_memory_mb", "seconds"}
# What the cache keeps beside results: locks, keys, and which run used what.
_BOOKKEEPING = {"CACHEDIR.TAG", "manifest.json", "names.lock", "in-use.lock", "runs"}
_KEY = re.compile("[0-9a-f]{64}")
_SECONDS = re.compile(r"\b\d+(\.\d+)? (s|ms|min)\b")


@dataclass(frozen=True)
class Difference:
    """One leaf that is not the same on both sides; `kind` is changed, gone, new or moved."""

    kind: str
    where: str
    first: str = ""
    second: str = ""

    def __str__(self) -> str:
        return f"{self.kind} {self.where}"


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


def of_folder(folder: Path, places: Mapping[str, str]) -> Leaves:
    """Return the leaves of all files of a folder; entries of a cache go by their stage, not by their key.

    Parameters
    ----------
    places : what stands for a folder in texts, so that it may be another on the other side.
    """
    found: dict[str, list[Leaves]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and not _BOOKKEEPING.intersection(parts):
            name = "/".join("KEY" if _KEY.fullmatch(part) else part for part in parts)
            found[name].append(of_file(path, name, places))
    leaves: Leaves = {}
    for name, entries in found.items():
        if len(entries) == 1:
            leaves |= entries[0]
        else:
            # Several entries of one stage: their keys, and so their order, mean nothing.
            ordered = sorted(entries, key=lambda entry: sorted(entry.items()))
            leaves |= {
                f"{name} #{n}{key[len(name) :]}": v for n, e in enumerate(ordered) for key, v in e.items()
            }
    return leaves


def of_file(path: Path, name: str, places: Mapping[str, str]) -> Leaves:
    """Return the leaves of a file: of a JSON document, of an archive's members, or its digest."""
    if path.suffix == ".json":
        return of_output(path.read_text(), name, places)
    if path.suffix in (".npz", ".zip") and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return {f"{name}:{member}": _digest(archive.read(member)) for member in archive.namelist()}
    return {name: _digest(path.read_bytes())}


def of_output(text: str, name: str, places: Mapping[str, str]) -> Leaves:
    """Return the leaves of JSON text, or the lines of any other."""
    try:
        return of_json(json.loads(text), name, places)
    except ValueError:
        return of_lines(text, name, places)


def of_json(document: Any, name: str, places: Mapping[str, str]) -> Leaves:
    """Return the values of a document by where they stand in it, such as `report.json:mesh.edges.count`."""
    return {f"{name}:{'.'.join(keys)}": _placed(value, places) for keys, value in _values(document)}


def _values(document: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    if isinstance(document, Mapping) and document:
        for key, value in document.items():
            if key not in VOLATILE:
                yield from _values(value, (*keys, key))
    elif isinstance(document, list) and document:
        for number, value in enumerate(document):
            yield from _values(value, (*keys, str(number)))
    else:
        yield keys, json.dumps(document, ensure_ascii=False)


def of_lines(text: str, name: str, places: Mapping[str, str]) -> Leaves:
    """Return the lines of a text, each with how often it is there; seconds are left out of them."""
    lines = (_SECONDS.sub("SECONDS", line.rstrip()) for line in _placed(text, places).splitlines())
    return {f"{name}: {line}": str(count) for line, count in Counter(lines).items() if line}


def _placed(text: str, places: Mapping[str, str]) -> str:
    # The longest first: one folder may lie in another.
    for folder in sorted(places, key=len, reverse=True):
        text = text.replace(folder, places[folder])
    return text


def _digest(data: bytes) -> str:
    return f"{len(data):,} bytes, {hashlib.sha256(data).hexdigest()}"


def differences(first: Leaves, second: Leaves) -> list[Difference]:
    """Return where two sides differ. A value that only has another name now is told as moved.

    Moved is a value of one document that is gone from one place and new in another, when the last part of
    the name is the same, or no other that is gone or new there has this value.
    """
    found = [
        Difference("changed", name, value, second[name])
        for name, value in first.items()
        if name in second and second[name] != value
    ]
    gone = [name for name in first if name not in second]
    new = [name for name in second if name not in first]
    for before, after in _moved(gone, new, first, second):
        gone.remove(before)
        new.remove(after)
        found.append(Difference("moved", f"{before} -> {after}", first[before], second[after]))
    found += [Difference("gone", name, first[name]) for name in gone]
    found += [Difference("new", name, "", second[name]) for name in new]
    return sorted(found, key=lambda one: one.where)


def _moved(
    gone: Sequence[str], new: Sequence[str], first: Leaves, second: Leaves
) -> Iterator[tuple[str, str]]:
    unpaired_gone, unpaired_new = _by_value(gone, first), _by_value(new, second)
    for key, befores in unpaired_gone.items():
        afters = unpaired_new[key]
        for before in list(befores):
            alike = [after for after in afters if _last(after) == _last(before)]
            if len(alike) == 1 and sum(_last(other) == _last(before) for other in befores) == 1:
                befores.remove(before)
                afters.remove(alike[0])
                yield before, alike[0]
        if len(befores) == len(afters) == 1:
            yield befores[0], afters[0]


def _by_value(names: Sequence[str], leaves: Leaves) -> dict[tuple[str, str], list[str]]:
    """Return the names in documents by document and value; files and lines of text have no other name."""
    grouped: dict[tuple[str, str], list[str]] = defaultdict(list)
    for name in names:
        document, colon, place = name.partition(":")
        if colon and not place.startswith(" "):
            grouped[document, leaves[name]].append(name)
    return grouped


def _last(name: str) -> str:
    return name.rpartition(":")[2].rpartition(".")[2]
