"""Pages in one file, which open from a disk without a network: of models, and of the results of scans."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.stages.files.opening import content_of, opened

_HERE = Path(__file__).parent
# What each page has in its first kilobyte.
_MARK = b'<meta name="generator" content="scanloom">'
_MODULES = (
    "library.js",
    "tiles/camera.js",
    *(f"model/{path.stem}.js" for path in sorted((_HERE / "model").glob("*.js"))),
)
# Modules out of addresses have no folder: what they import gets a name of its own.
_IMPORT = re.compile(r'(from\s+|import\s+)"(\.[^"]+)"')


@dataclass(frozen=True)
class PageScale:
    """What the colours of a model stand for, in steps of one width.

    Attributes
    ----------
    unit : of the values.
    low, high : where the first step begins, and where the last ends.
    within : what is nearer to 0 is well; None where nothing is better than other.
    colors : of the steps, as CSS has them.
    shares : of the surface, that have a step's values.
    safe : colours for eyes that mix up red and green; None where all tell them apart.
    marks : the values that are written beside it; None for its ends and what is well.
    """

    unit: str
    low: float
    high: float
    within: float | None
    colors: list[str]
    shares: list[float]
    safe: list[str] | None = None
    marks: list[float] | None = None


@dataclass(frozen=True)
class PageLook:
    """Another look of a model, in colours that its vertices have beside its own.

    Attributes
    ----------
    name : what it is chosen by.
    channel : which of the numbers of `_VALUES` it shows, 0 to 255 from the low end of its scale to the high
        one; None for the vertex colours that are beside a texture.
    note : a few words beside the number of triangles.
    scale : what the numbers stand for; None for vertex colours.
    """

    name: str
    channel: int | None
    note: str = ""
    scale: PageScale | None = None


@dataclass(frozen=True)
class PageModel:
    """A model of a page.

    Attributes
    ----------
    name : what it is chosen by.
    glb : a GLB file that stands; EXT_meshopt_compression is understood.
    triangles : of it.
    note : a few words beside their number.
    facing : (3,) where its surface looks if it was seen from one side, z up; None if all around.
    scale : what its colours stand for; None if they are the thing's own.
    looks : others that it has.
    """

    name: str
    glb: bytes
    triangles: int
    note: str = ""
    facing: list[float] | None = None
    scale: PageScale | None = None
    looks: tuple[PageLook, ...] = ()


@dataclass(frozen=True)
class PageCamera:
    """A camera of the scan that a page's models come from.

    Attributes
    ----------
    frame : its name.
    pose : 12 numbers, row by row: takes points of the camera (OpenCV axes) to the upright frame, z up,
        metres.
    size : width and height of its image, pixels.
    focal, center : fx, fy, and cx, cy, pixels.
    photo : a JPEG file without lens distortion, of any size; None without one.
    mark : what is special about it: that it was held out, or why it was skipped.
    """

    frame: str
    pose: list[float]
    size: list[int]
    focal: list[float]
    center: list[float]
    photo: bytes | None = None
    mark: str = ""


def one_file(
    title: str,
    models: Sequence[PageModel],
    told: Mapping[str, Any] | None = None,
    cameras: Sequence[PageCamera] = (),
) -> bytes:
    """Return a page that shows models in one place, one or two at a time, and tells what belongs to them.

    Parameters
    ----------
    title : of the page.
    models : one or more.
    told : for JSON: `warnings`, sentences; `tables`, each with `title`, `head`, `rows` of words, and `places`
        to fly to, `target` (3,) in the upright frame, z up, and how far `away`, or from where, `eye` (3,);
        `texts`, each with `title` and `text`; `unit`, what lengths are in if it is not metres.
    cameras : of the scan, in order.
    """
    content = {
        "title": title,
        "files": [base64.b64encode(model.glb).decode() for model in models],
        "models": [*_own_looks(models), *_other_looks(models)],
        "cameras": [{**vars(camera), "photo": _photo(camera.photo)} for camera in cameras],
        **(told or {}),
    }
    imports = {f"scanloom/{name}": _address(name) for name in _MODULES}
    page = content_of(_HERE / "model" / "index.html").decode()
    licenses = content_of(_HERE / "LICENSES.txt").decode().replace("--", "- -")
    page = page.replace("IMPORTS", json.dumps({"imports": imports}), 1)
    page = page.replace("CONTENT", _script_json(content), 1)
    return f"{page}<!--\n{licenses}\n-->\n".encode()


def _own_looks(models: Sequence[PageModel]) -> Iterator[dict[str, Any]]:
    for file, model in enumerate(models):
        yield {"look": "own", **_described(file, model, model)}


def _other_looks(models: Sequence[PageModel]) -> Iterator[dict[str, Any]]:
    for file, model in enumerate(models):
        for look in model.looks:
            shown = "colors" if look.channel is None else look.channel
            yield {"look": shown, **_described(file, model, look)}


def _described(file: int, model: PageModel, look: PageModel | PageLook) -> dict[str, Any]:
    return {
        "file": file,
        "name": look.name,
        "note": look.note,
        "triangles": model.triangles,
        "facing": model.facing,
        "scale": None if look.scale is None else vars(look.scale),
    }


def scans_page(title: str, rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Return a page that lists the results of many scans, which lie in folders beside the page.

    Pictures are loaded from these folders, and nothing else is loaded.

    Parameters
    ----------
    rows : for JSON, one for each scan: `scan` (name), `state`, `reason`, `warnings` (sentences), `out`
        (folder of the results, relative to the page), files in that folder (`picture`, `page`, `result`), and
        the scan's statistics by name; None for a missing value.
    """
    page = content_of(_HERE / "scans" / "index.html").decode()
    return page.replace("CONTENT", _script_json({"title": title, "rows": rows}), 1).encode()


def _script_json(content: Mapping[str, Any]) -> str:
    """Return JSON text for a script element, where HTML would read the end tag or a comment in a string."""
    return json.dumps(content).replace("<", "\\u003c")


def is_page(path: Path) -> bool:
    """Return whether a file is a page that `one_file` or `scans_page` made."""
    with opened(path) as file:
        return _MARK in file.read(1024)


def _photo(data: bytes | None) -> str | None:
    return None if data is None else f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def _address(name: str) -> str:
    text = content_of(_HERE / name).decode()
    folder = Path(name).parent

    def named(found: re.Match[str]) -> str:
        parts: list[str] = []
        for part in (folder / found[2]).parts:
            if part == "..":
                parts.pop()
            else:
                parts.append(part)
        return f'{found[1]}"scanloom/{"/".join(parts)}"'

    if name != "library.js":
        text = _IMPORT.sub(named, text)
    return f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"
