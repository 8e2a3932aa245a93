"""Conversion of docstrings with numpydoc sections to Markdown.

Entries of sections have the form `name : meaning`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from inspect import cleandoc

from making.markdown import escape_markdown, format_code, format_definitions

# Sections whose entries have names.
_LIST_SECTIONS = ("Parameters", "Attributes", "Raises", "Returns", "Yields")
_HEADING = re.compile(r"^([A-Z]\w+)\n-+\n", flags=re.MULTILINE)


def convert_docstring(docstring: str | None) -> str:
    """Convert a docstring to Markdown, sections to definition lists."""
    before, *sections = _HEADING.split(cleandoc(docstring or ""))
    written = [_convert_prose(before)]
    for name, text in zip(sections[::2], sections[1::2], strict=True):
        written.append(f"**{name}**")
        written.append(_convert_entries(text) if name in _LIST_SECTIONS else _convert_prose(text))
    return "\n\n".join(part for part in written if part)


def _convert_prose(text: str) -> str:
    """Escape paragraphs; turn examples and indented text into code blocks."""
    written = []
    for paragraph in re.split(r"\n\s*\n", text.strip()):
        if paragraph.startswith(">>>"):
            written.append(f"```python\n{paragraph}\n```")
        elif re.match(r"^    ", paragraph):
            written.append(f"```text\n{cleandoc(paragraph)}\n```")
        else:
            written.append(escape_markdown(paragraph))
    return "\n\n".join(written)


def _convert_entries(text: str) -> str:
    entries = list(_split_entries(text))
    if not all(meaning for _, meaning in entries):
        # A single type or text without a name.
        return "\n\n".join(escape_markdown(f"{name} {meaning}".strip()) for name, meaning in entries)
    return format_definitions((format_code(name), escape_markdown(meaning), "") for name, meaning in entries)


def _split_entries(text: str) -> Iterator[tuple[str, str]]:
    """Yield name and meaning of each entry, joining indented continuation lines."""
    for entry in re.split(r"\n(?=\S)", text.strip()):
        first, *more = entry.split("\n")
        name, _, begun = first.partition(" : ")
        yield name.strip(), " ".join([begun, *(line.strip() for line in more)]).strip()
