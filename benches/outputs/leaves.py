"""Outputs of a job as leaves, each a name and a value.

A leaf is a file with the digest of its bytes, a member of an archive, a value of a JSON document, or a line
of text. Values that differ in every run are left out: seconds, dates, memory, cache keys.
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

# JSON keys whose values differ in every run.
VOLATILE = {"created", "last_used", "compute_seconds", "peak_memory_mb", "seconds"}
# Files of the cache that are not results: locks, keys, and lists of the entries that runs used.
_BOOKKEEPING = {"CACHEDIR.TAG", "manifest.json", "names.lock", "in-use.lock", "runs"}
_KEY = re.compile("[0-9a-f]{64}")
_SECONDS = re.compile(r"\b\d+(\.\d+)? (s|ms|min)\b")


def collect_folder_leaves(folder: Path, placeholders: Mapping[str, str]) -> Leaves:
    """Collect the leaves of all files in a folder.

    Cache entries are named by their stage instead of their key.

    Parameters
    ----------
    placeholders : placeholder for each folder name in texts, because folders differ between the two sides.
    """
    found: dict[str, list[Leaves]] = defaultdict(list)
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and not _BOOKKEEPING.intersection(parts):
            name = "/".join("KEY" if _KEY.fullmatch(part) else part for part in parts)
            found[name].append(collect_file_leaves(path, name, placeholders))
    leaves: Leaves = {}
    for name, entries in found.items():
        if len(entries) == 1:
            leaves |= entries[0]
        else:
            # Several entries of one stage are ordered by content, because the order of keys is arbitrary.
            ordered = sorted(entries, key=lambda entry: sorted(entry.items()))
            leaves |= {
                f"{name} #{n}{key[len(name) :]}": v for n, e in enumerate(ordered) for key, v in e.items()
            }
    return leaves


def collect_file_leaves(path: Path, name: str, placeholders: Mapping[str, str]) -> Leaves:
    """Collect a file's leaves: JSON values, archive members, or a digest."""
    if path.suffix == ".json":
        return collect_text_leaves(path.read_text(), name, placeholders)
    if path.suffix in (".npz", ".zip") and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            return {f"{name}:{member}": _format_digest(archive.read(member)) for member in archive.namelist()}
    return {name: _format_digest(path.read_bytes())}


def collect_text_leaves(text: str, name: str, placeholders: Mapping[str, str]) -> Leaves:
    """Collect the leaves of printed text: JSON values, or lines."""
    try:
        return collect_json_leaves(json.loads(text), name, placeholders)
    except ValueError:
        return count_lines(text, name, placeholders)


def collect_json_leaves(document: Any, name: str, placeholders: Mapping[str, str]) -> Leaves:
    """Collect the values of a document by path: `report.json:mesh.edges.count`."""
    return {
        f"{name}:{'.'.join(keys)}": _insert_placeholders(value, placeholders)
        for keys, value in _walk_values(document)
    }


def _walk_values(document: Any, keys: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], str]]:
    if isinstance(document, Mapping) and document:
        for key, value in document.items():
            if key not in VOLATILE:
                yield from _walk_values(value, (*keys, key))
    elif isinstance(document, list) and document:
        for number, value in enumerate(document):
            yield from _walk_values(value, (*keys, str(number)))
    else:
        yield keys, json.dumps(document, ensure_ascii=False)


def count_lines(text: str, name: str, placeholders: Mapping[str, str]) -> Leaves:
    """Count the lines of a text, with durations masked."""
    lines = (
        _SECONDS.sub("SECONDS", line.rstrip())
        for line in _insert_placeholders(text, placeholders).splitlines()
    )
    return {f"{name}: {line}": str(count) for line, count in Counter(lines).items() if line}


def _insert_placeholders(text: str, placeholders: Mapping[str, str]) -> str:
    # Longest first, because one folder may contain another.
    for folder in sorted(placeholders, key=len, reverse=True):
        text = text.replace(folder, placeholders[folder])
    return text


def _format_digest(data: bytes) -> str:
    return f"{len(data):,} bytes, {hashlib.sha256(data).hexdigest()}"
