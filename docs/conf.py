"""Sphinx configuration of the documentation site, built by `make docs`.

The source folder is the whole checkout, so that links to README.md work as on a code host. Only the pages
listed below are read. The build downloads nothing, and the site works from a local disk.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "docs")]

from making import message_list, page_blocks  # noqa: E402

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
# Anchors of headings down to level 3, with the names that code hosts use.
myst_heading_anchors = 3
myst_enable_extensions = ["deflist"]
# Otherwise "--" in options would become a dash.
smartquotes = False
# Blocks without a language are terminal output.
highlight_language = "text"

html_theme = "furo"
html_static_path = ["static"]
html_css_files = ["site.css"]
# A local disk does not serve index pages of folders, so a page at the top links to docs/index.
html_additional_pages = {"index": "beginning.html"}
templates_path = ["templates"]
html_show_sphinx = False
html_show_copyright = False
html_copy_source = False
html_theme_options: dict[str, Any] = {"navigation_with_keys": True}


def setup(app: Sphinx) -> None:
    """Connect the generators of page content."""
    app.connect("source-read", page_blocks.fill_page)
    app.connect("build-finished", message_list.write_list)
