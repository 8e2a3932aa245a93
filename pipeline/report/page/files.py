"""The page of a tileset: files in the folder of the tiles."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.opening import content_of
from scanloom.stages.lod.tiles import PAGE_FOLDER, PAGE_INDEX

_HERE = Path(__file__).parent
_LIBRARY = ("library.js", "LICENSES.txt")


def tiles_page() -> dict[str, bytes]:
    """Return the page that draws the tileset in its folder: contents by their paths in that folder.

    All but `index.html` is below `page/`: the libraries, as one file with their licences, and the page's own
    modules. It asks for nothing from anywhere else.
    """
    own = sorted(path.name for path in (_HERE / "tiles").glob("*.js"))
    below = [*_LIBRARY, *(f"tiles/{name}" for name in own)]
    return {
        PAGE_INDEX: content_of(_HERE / "tiles" / PAGE_INDEX),
        **{f"{PAGE_FOLDER}/{name}": content_of(_HERE / name) for name in below},
    }


def write_tiles_page(folder: Path | str) -> None:
    """Write the page that draws a tileset into the folder of the tileset.

    The page is `index.html` and the folder `page/`. A web server has to serve the folder, since browsers load
    no other files for a page that was opened from a disk.

    Raises
    ------
    StageError
        If the system refuses to write.
    """
    index, *others = tiles_page().items()
    try:
        # The index goes last: it must find all other files.
        for name, content in (*others, index):
            path = Path(folder) / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    except OSError as error:
        raise StageError(
            FILE_OUTPUT_REFUSED,
            "cannot be written: {detail}.",
            where=Path(folder),
            detail=error.strerror or error,
        ) from error
