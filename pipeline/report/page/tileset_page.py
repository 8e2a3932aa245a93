"""Page of a tileset, as files in the tileset folder."""

from __future__ import annotations

from pathlib import Path

from scanloom.stages.diagnostics.errors import StageError
from scanloom.stages.files.codes import FILE_OUTPUT_REFUSED
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.lod.tiles import PAGE_FOLDER, PAGE_INDEX

_HERE = Path(__file__).parent
_LIBRARY = ("library.js", "LICENSES.txt")


def make_tileset_page() -> dict[str, bytes]:
    """Return the files of the tileset page by relative path.

    All files except `index.html` are in `page/`: bundled libraries, their licences, and the modules of the
    page. The page loads nothing from other servers.
    """
    own = sorted(path.name for path in (_HERE / "tiles").glob("*.js"))
    below = [*_LIBRARY, *(f"tiles/{name}" for name in own)]
    return {
        PAGE_INDEX: read_input_bytes(_HERE / "tiles" / PAGE_INDEX),
        **{f"{PAGE_FOLDER}/{name}": read_input_bytes(_HERE / name) for name in below},
    }


def write_tileset_page(folder: Path | str) -> None:
    """Write the tileset page into the folder of a tileset.

    The page is `index.html` and the folder `page/`. The folder must be served by a web server, because
    browsers load no further files for a page opened from disk.

    Raises
    ------
    StageError
        If a file cannot be written.
    """
    index, *others = make_tileset_page().items()
    try:
        # Write the index last, so that it never refers to missing files.
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
