"""Single-file pages that open from disk without a network."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanloom.stages.files.input_files import open_input, read_input_bytes

_HERE = Path(__file__).parent
# Marker in the first kilobyte of every page.
_PAGE_MARKER = b'<meta name="generator" content="scanloom">'
_MODULES = (
    "library.js",
    "tiles/camera.js",
    *(f"model/{path.stem}.js" for path in sorted((_HERE / "model").glob("*.js"))),
)
# Modules in data URLs cannot use relative imports, so imports are rewritten to names of an import map.
_IMPORT = re.compile(r'(from\s+|import\s+)"(\.[^"]+)"')


@dataclass(frozen=True)
class PageScale:
    """Colour scale of a model, in equal steps.

    Attributes
    ----------
    unit : unit of the values.
    low, high : start of the first step and end of the last step.
    within : tolerance; smaller absolute values are in tolerance. None without a tolerance.
    colors : CSS colour of each step.
    shares : ratio of the surface in each step.
    safe : colours for colour-blind readers; None if `colors` are suitable.
    marks : labelled values; None for the ends and the tolerance.
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
class PageColoring:
    """Alternative colouring of a model.

    Attributes
    ----------
    name : name in the menu.
    channel : component of the vertex attribute `_VALUES` to show, 0 to 255 from `scale.low` to `scale.high`;
        None for the vertex colours of a textured model.
    note : short text shown with the triangle count.
    scale : colour scale of the values; None for vertex colours.
    """

    name: str
    channel: int | None
    note: str = ""
    scale: PageScale | None = None


@dataclass(frozen=True)
class PageModel:
    """Model of a page.

    Attributes
    ----------
    name : name in the menu.
    glb : content of an upright GLB file, which may use EXT_meshopt_compression.
    triangles : triangle count.
    note : short text shown with the triangle count.
    facing : (3,) mean normal of a surface seen from one side, z up; None if seen from all around.
    scale : colour scale; None if the model has the natural colours of the object.
    colorings : alternative colourings.
    """

    name: str
    glb: bytes
    triangles: int
    note: str = ""
    facing: list[float] | None = None
    scale: PageScale | None = None
    colorings: tuple[PageColoring, ...] = ()


@dataclass(frozen=True)
class PageCamera:
    """Camera of the scan.

    Attributes
    ----------
    frame : frame name.
    pose : 12 numbers, row-major (3, 4) matrix from camera coordinates (OpenCV axes) to the upright frame, z
        up, metres.
    size : image width and height in pixels.
    focal, center : (fx, fy) and (cx, cy) in pixels.
    photo : JPEG file without lens distortion, of any size; None without a photo.
    mark : label of a special frame: held out, or why it was skipped.
    """

    frame: str
    pose: list[float]
    size: list[int]
    focal: list[float]
    center: list[float]
    photo: bytes | None = None
    mark: str = ""


def make_single_file_page(
    title: str,
    models: Sequence[PageModel],
    report_data: Mapping[str, Any] | None = None,
    cameras: Sequence[PageCamera] = (),
) -> bytes:
    """Make a single-file page of models with report data.

    The page shows one or two models at a time.

    Parameters
    ----------
    title : page title.
    models : one or more models in the same upright frame.
    report_data : JSON-ready report data. `header`: see `make_page_header`. `warnings`: list of sentences.
        `tables`: each with `title`, `head`, `rows` of text, optionally an explanation `text`, True in
        `folded`, and `places` to fly to, with `target` (3,) in the upright frame, z up, and the distance
        `away` or the viewpoint `eye` (3,). `texts`: each with `title` and `text`. `unit`: unit of lengths,
        if not metres. `rotation`: row-major (3, 3) rotation from scan coordinates to the upright frame; none
        by default.
    cameras : cameras of the scan, in order.
    """
    content = {
        "title": title,
        "files": [base64.b64encode(model.glb).decode() for model in models],
        "models": [*_describe_models(models), *_describe_colorings(models)],
        "cameras": [{**vars(camera), "photo": make_image_url(camera.photo)} for camera in cameras],
        **(report_data or {}),
    }
    imports = {f"scanloom/{name}": _make_module_url(name) for name in _MODULES}
    page = read_input_bytes(_HERE / "model" / "index.html").decode()
    licenses = read_input_bytes(_HERE / "LICENSES.txt").decode().replace("--", "- -")
    page = page.replace("IMPORTS", json.dumps({"imports": imports}), 1)
    page = page.replace("CONTENT", _format_script_json(content), 1)
    return f"{page}<!--\n{licenses}\n-->\n".encode()


def _describe_models(models: Sequence[PageModel]) -> Iterator[dict[str, Any]]:
    for file, model in enumerate(models):
        yield {"look": "own", **_describe_model(file, model, model)}


def _describe_colorings(models: Sequence[PageModel]) -> Iterator[dict[str, Any]]:
    for file, model in enumerate(models):
        for look in model.colorings:
            shown = "colors" if look.channel is None else look.channel
            yield {"look": shown, **_describe_model(file, model, look)}


def _describe_model(file: int, model: PageModel, coloring: PageModel | PageColoring) -> dict[str, Any]:
    return {
        "file": file,
        "name": coloring.name,
        "note": coloring.note,
        "triangles": model.triangles,
        "facing": model.facing,
        "scale": None if coloring.scale is None else vars(coloring.scale),
    }


def make_scans_page(title: str, rows: Sequence[Mapping[str, Any]]) -> bytes:
    """Make a single-file page that lists the results of many scans.

    The page loads pictures from the result folders, and nothing else.

    Parameters
    ----------
    title : page title.
    rows : JSON-ready rows, one per scan: `scan` (name), `state`, `reason`, `warnings` (sentences), `out`
        (result folder relative to the page), files in that folder (`picture`, `page`, `result`), and metrics
        of the scan by name; None for a missing value.
    """
    page = read_input_bytes(_HERE / "scans" / "index.html").decode()
    return page.replace("CONTENT", _format_script_json({"title": title, "rows": rows}), 1).encode()


def _format_script_json(content: Mapping[str, Any]) -> str:
    """Format JSON for a script element.

    Every `<` is escaped, so that no HTML end tag can occur.
    """
    return json.dumps(content).replace("<", "\\u003c")


def is_page(path: Path) -> bool:
    """Return True if a file was made by `make_single_file_page` or `make_scans_page`."""
    with open_input(path) as file:
        return _PAGE_MARKER in file.read(1024)


def make_image_url(data: bytes | None) -> str | None:
    """Embed a JPEG file as a data URL."""
    return None if data is None else f"data:image/jpeg;base64,{base64.b64encode(data).decode()}"


def _make_module_url(name: str) -> str:
    text = read_input_bytes(_HERE / name).decode()
    folder = Path(name).parent

    def rewrite_import(found: re.Match[str]) -> str:
        parts: list[str] = []
        for part in (folder / found[2]).parts:
            if part == "..":
                parts.pop()
            else:
                parts.append(part)
        return f'{found[1]}"scanloom/{"/".join(parts)}"'

    if name != "library.js":
        text = _IMPORT.sub(rewrite_import, text)
    return f"data:text/javascript;base64,{base64.b64encode(text.encode()).decode()}"
