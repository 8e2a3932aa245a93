"""How Sphinx makes the site of these pages; `make docs` calls it.

The whole checkout is the source, so that a page leads to README.md as it does on a code host; only the pages
named below are read. Nothing is fetched, and what is built opens from a disk.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

from making import finder, written  # noqa: E402

from scanloom import __version__  # noqa: E402

if TYPE_CHECKING:
    from sphinx.application import Sphinx

project = "scanloom"
release = __version__
html_title = f"scanloom {__version__}"

root_doc = "docs/index"
include_patterns = ["docs/**.md", "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "samples/README.md"]
exclude_patterns = [
    ".*",
    "benches",
    "build",
    "cli",
    "demo",
    "kernels",
    "pipeline",
    "stages",
    "tests",
    "docs/making",
]

extensions = ["myst_parser"]
# Headings down to the third have anchors, named as code hosts name them.
myst_heading_anchors = 3
myst_enable_extensions = ["deflist"]
# Options begin with two hyphens, which are not a dash.
smartquotes = False
# What a block without a name holds is words for a terminal.
highlight_language = "text"

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
# A disk has no page "docs/": its beginning leads to the index.
html_additional_pages = {"index": "beginning.html"}
templates_path = ["templates"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_theme_options: dict[str, Any] = {"navigation_with_keys": True}


def setup(app: Sphinx) -> None:
    """Put in what is made from the code."""
    app.connect("source-read", written.fill_in)
    app.connect("build-finished", finder.write_list)
