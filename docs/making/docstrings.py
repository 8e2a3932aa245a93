"""Conversion of docstrings with numpydoc sections to Markdown.

Entries of sections have the form `name : meaning`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from inspect import cleandoc

from making.markdown import code, definitions, escaped

# Sections whose entries have names.
_LISTS = ("Parameters", "Attributes", "Raises", "Returns", "Yields")
_HEADING = re.compile(r"^([A-Z]\w+)\n-+\n", flags=re.MULTILINE)


def as_markdown(docstring: str | None) -> str:
    """Convert a docstring to Markdown, sections to definition lists."""
    before, *sections = _HEADING.split(cleandoc(docstring or ""))
    written = [_prose(before)]
    for name, text in zip(sections[::2], sections[1::2], strict=True):
        written.append(f"**{name}**")
        written.append(_entries(text) if name in _LISTS else _prose(text))
    return "\n\n".join(part for part in written if part)


def _prose(text: str) -> str:
    """Escape paragraphs; turn examples and indented text into code blocks."""
    written = []
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        if paragraph.startswith(">>>"):
            written.append(f"```python\n{paragraph}\n```")
        elif re.match(r"^    ", paragraph):
            written.append(f"```text\n{cleandoc(paragraph)}\n```")
        else:
            written.append(escaped(paragraph))
    return "\n\n".join(written)


def _entries(text: str) -> str:
    entries = list(_split(text))
    if not all(meaning for _, meaning in entries):
        # A single type or text without a name.
        return "\n\n".join(escaped(f"{name} {meaning}".strip()) for name, meaning in entries)
    return definitions((code(name), escaped(meaning), "") for name, meaning in entries)


def _split(text: str) -> Iterator[tuple[str, str]]:
    """Yield name and meaning of each entry, joining indented continuation lines."""
    for entry in re.split(r"\n(?=\S)", text.strip()):
        first, *more = entry.split("\n")
        name, _, begun = first.partition(" : ")
        yield name.strip(), " ".join([begun, *(line.strip() for line in more)]).strip()
