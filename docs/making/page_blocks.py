"""Generated content in documentation pages.

A page requests content in a block such as:

    ```{made} parameters fuse
    `scanloom config` prints these.
    ```

The text in the block is shown to readers of the Markdown file. On the site it is replaced by the list of
parameters.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from making import commands, parameters, python

if TYPE_CHECKING:
    from sphinx.application import Sphinx

PAGES = Path(__file__).resolve().parents[1]
# Pages that other parts of the table of contents list, and the first pages of the guides.
_LISTED_ELSEWHERE = ("index", "tutorial", "capturing", "stages")
_FIRST_PAGES = ("command-line", "report", "simplification", "exporting", "comparing", "checking")


def write_guides() -> str:
    """Write the table of contents of pages that are listed nowhere else."""
    names = {path.stem for path in PAGES.glob("*.md")} - set(_LISTED_ELSEWHERE)
    listed = [name for name in _FIRST_PAGES if name in names]
    return "\n".join(
        ["```{toctree}", ":caption: Guides", ":hidden:", "", *listed, *sorted(names - set(listed)), "```"]
    )


GENERATORS: dict[str, Any] = {
    "guides": write_guides,
    "parameters": parameters.list_section,
    "qualities": parameters.write_quality_table,
    "configuration": parameters.list_all_sections,
    "commands": commands.write_reference,
    "python": python.write_reference,
}

_BLOCK = re.compile(r"^```\{made\} *(?P<what>[^\n]*)\n.*?^```$", flags=re.MULTILINE | re.DOTALL)


def fill_page(app: Sphinx, page: str, source: list[str]) -> None:  # noqa: ARG001 - Sphinx calls it so
    """Replace all blocks in the source of a page, in place."""
    source[0] = fill_blocks(source[0])


def fill_blocks(text: str) -> str:
    """Replace all blocks in a page's text with generated content."""
    return _BLOCK.sub(_fill_block, text)


def _fill_block(block: re.Match[str]) -> str:
    maker, *words = block["what"].split()
    return str(GENERATORS[maker](*words))
