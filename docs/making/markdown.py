"""Escaping and definition lists in Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable


def escape_markdown(text: str) -> str:
    """Escape plain text for Markdown, keeping code in backticks."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part if part.startswith("`") else re.sub(r"([\\*_<>\[\]|#$~{}])", r"\\\1", part) for part in parts
    )


def format_code(text: str) -> str:
    """Format text as inline code, whatever backticks it contains."""
    longest = max((len(run) for run in re.findall("`+", text)), default=0)
    fence = "`" * (longest + 1)
    space = " " if text.startswith("`") or text.endswith("`") else ""
    return f"{fence}{space}{text}{space}{fence}"


def format_definitions(entries: Iterable[tuple[str, str, str]]) -> str:
    """Format a definition list.

    Parameters
    ----------
    entries : term, meaning, and facts, which get a separate line.
    """
    written = []
    for term, meaning, facts in entries:
        lines = [term, f": {meaning}"]
        if facts:
            lines += ["", f"  *{facts}*"]
        written.append("\n".join(lines))
    return "\n\n".join(written) + "\n"
