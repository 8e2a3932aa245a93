"""What a job left behind as leaves, each a name and a value.

A leaf is a file and the digest of its bytes, a member of an archive, a value in a JSON document, or a line of
text. What is different in each run has no leaf: seconds, dates, memory, keys of the cache.
"""

from __future__ import annotations

import hashlib
import json
import re
import zipfile
from collections import Counter, defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

Leaves = dict[str, str]

# Keys of JSON whose values belong to one run.
VOLATILE = {"created", "last_used", "made_in_s", "peak_memory_mb", "seconds"}
# What the cache keeps beside results: locks, keys, and which run used what.
_BOOKKEEPING = {"CACHEDIR.TAG", "manifest.json", "names.lock", "in-use.lock", "runs"}
_KEY = re.compile("[0-9a-f]{64}")
_SECONDS = re.compile(r"\b\d+(\.\d+)? (s|ms|min)\b")


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
