"""The list in which a pasted message is looked for: what each says, and where it is explained."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

from docutils import nodes  # type: ignore[import-untyped]

from making.messages import PAGES, ROOT, entries

if TYPE_CHECKING:
    from sphinx.application import Sphinx

FILE = "_static/messages-list.js"


def write_list(app: Sphinx, failure: Exception | None) -> None:
    """Write the list beside the pages, when they are built."""
    if failure is not None:
        return
    folder = PAGES.relative_to(ROOT).as_posix()
    anchors: dict[tuple[str, str], str] = {}
    for path in PAGES.glob("*.md"):
        for section in app.env.get_doctree(f"{folder}/{path.stem}").findall(nodes.section):
            title = section[0].astext().replace("`", "")
            anchors[path.name, title] = f"{path.stem}.html#{section['ids'][0]}"
    listed = [
        [entry.form, entry.heading.replace("`", ""), anchors[entry.page, entry.heading.replace("`", "")]]
        for entry in entries()
    ]
    text = f"window.scanloomMessages = {json.dumps(listed, ensure_ascii=False)};\n"
    (Path(app.outdir) / FILE).write_text(text, encoding="utf-8")
