"""Text of the code as Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable


def escaped(text: str) -> str:
    """Return a plain text as Markdown: what is between backticks is code, and nothing else has a meaning."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(
        part if part.startswith("`") else re.sub(r"([\\*_<>\[\]|#$~{}])", r"\\\1", part) for part in parts
    )


def code(text: str) -> str:
    """Return a text as inline code, whatever backticks are in it."""
    longest = max((len(run) for run in re.findall("`+", text)), default=0)
    fence = "`" * (longest + 1)
    space = " " if text.startswith("`") or text.endswith("`") else ""
    return f"{fence}{space}{text}{space}{fence}"


def definitions(entries: Iterable[tuple[str, str, str]]) -> str:
    """Return a definition list: of each entry the term, what it means, and facts in a line of their own."""
    written = []
    for term, meaning, facts in entries:
        lines = [term, f": {meaning}"]
        if facts:
            lines += ["", f"  *{facts}*"]
        written.append("\n".join(lines))
    return "\n\n".join(written) + "\n"
