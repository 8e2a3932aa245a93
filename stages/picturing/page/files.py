"""The files of a page, as they stand in a folder beside what it draws."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.files.opening import content_of

_HERE = Path(__file__).parent
_LIBRARY = ("library.js", "LICENSES.txt")
# What a folder that holds a page has of it at its top.
INDEX, FOLDER = "index.html", "page"


def tiles_page() -> dict[str, bytes]:
    """Return the page that draws the tileset in its folder: contents by their paths in that folder.

    All but `index.html` is below `page/`: the libraries, as one file with their licences, and the page's own
    modules. It asks for nothing from anywhere else.
    """
    own = sorted(path.name for path in (_HERE / "tiles").glob("*.js"))
    below = [*_LIBRARY, *(f"tiles/{name}" for name in own)]
    return {
        INDEX: content_of(_HERE / "tiles" / INDEX),
        **{f"{FOLDER}/{name}": content_of(_HERE / name) for name in below},
    }
