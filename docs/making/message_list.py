"""List of messages for the search page, with links to their explanations.

A pasted message is compared with this list.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from docutils import nodes  # type: ignore[import-untyped]

from making.diagnostics import PAGES, ROOT, find_codes, find_constants, find_messages, find_page

if TYPE_CHECKING:
    from sphinx.application import Sphinx

FILE = "_static/messages-list.js"


def write_list(app: Sphinx, failure: Exception | None) -> None:
    """Write the list into the built site."""
    if failure is not None:
        return
    folder = PAGES.relative_to(ROOT).as_posix()
    anchors: dict[str, tuple[str, str]] = {}
    for one in find_codes():
        page = find_page(one.name)
        for section in app.env.get_doctree(f"{folder}/{page}").findall(nodes.section):
            title = section[0].astext()
            if title == one.title.replace("`", ""):
                anchors[one.name] = title, f"{page}.html#{section['ids'][0]}"
    names = find_constants()
    texts = [(one.text, names[one.constant]) for one in find_messages()]
    texts += [(text, one.name) for one in find_codes() for text in (one.example, one.name)]
    listed = [[text, *anchors[name]] for text, name in texts]
    content = f"window.scanloomMessages = {json.dumps(listed, ensure_ascii=False)};\n"
    (Path(app.outdir) / FILE).write_text(content, encoding="utf-8")
