"""Put what is made from the code where a page asks for it.

A page has, say:

    ```{made} parameters fuse
    `scanloom config` prints these.
    ```

The text within is what a reader of the page itself sees; on the site, the list of parameters stands there.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from making import commands, parameters, python

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGES = Path(__file__).resolve().parents[1]
# Pages beside the index that stand elsewhere in the table of contents, and the first of the others.
_ELSEWHERE = ("index", "tutorial", "capturing", "stages")
_FIRST = ("command-line", "report", "simplification", "exporting", "comparing", "checking")


def guides() -> str:
    """Return a table of contents of all pages beside the index that stand nowhere else."""
    names = {path.stem for path in PAGES.glob("*.md")} - set(_ELSEWHERE)
    listed = [name for name in _FIRST if name in names]
    return "\n".join(
        ["```{toctree}", ":caption: Guides", ":hidden:", "", *listed, *sorted(names - set(listed)), "```"]
    )


MAKERS: dict[str, Any] = {
    "guides": guides,
    "parameters": parameters.of_section,
    "qualities": parameters.of_qualities,
    "configuration": parameters.of_all,
    "commands": commands.reference,
    "python": python.reference,
}

_BLOCK = re.compile(r"^```\{made\} *(?P<what>[^\n]*)\n.*?^```$", flags=re.MULTILINE | re.DOTALL)


def fill_in(app: Sphinx, page: str, source: list[str]) -> None:  # noqa: ARG001 - Sphinx calls it so
    """Replace every such block of a page's text, in place."""
    source[0] = filled_in(source[0])


def filled_in(text: str) -> str:
    """Return a page's text with what is made from the code."""
    return _BLOCK.sub(_made, text)


def _made(block: re.Match[str]) -> str:
    maker, *words = block["what"].split()
    return str(MAKERS[maker](*words))
