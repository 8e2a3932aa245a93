"""Pages of docs/when-it-goes-wrong, generated from the diagnostic codes.

    PYTHONPATH=.:docs python -m making.diagnostics

writes the pages. Tests compare them with the codes. The index is written by hand.
"""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from scanloom.stages.diagnostics.diagnostic import Code, get_declared_codes

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("cli", "pipeline", "stages")
PAGES = ROOT / "docs" / "when-it-goes-wrong"


@dataclass(frozen=True)
class Page:
    """Page for the codes of some topics.

    Attributes
    ----------
    topics : parts of the names of codes before the dot.
    title : heading of the page.
    text : introduction, Markdown.
    """

    topics: tuple[str, ...]
    title: str
    text: str


PAGE_TABLE = {
    "words": Page(
        ("usage", "config"),
        "Options, configuration, arguments",
        "Exit code 2: nothing was done yet. `scanloom COMMAND --help` lists every option with its"
        " unit and range; [one page](../reference/configuration.md) has all parameters.",
    ),
    "machine": Page(
        ("machine",),
        "The machine: memory, disk, cache, libraries",
        "These concern the computer, not the data. `scanloom doctor` prints memory, disk, "
        "processor and libraries.",
    ),
    "scan-folders": Page(
        ("scan", "frame"),
        "Scan folders: layout and frames",
        "`scanloom inspect SCAN` finds most of these before any work. [The "
        "README](../../README.md) lists the layouts. Any recording can be brought into one of the"
        " two [plain layouts](../formats/scans.md).",
    ),
    "cameras-and-poses": Page(
        ("camera", "pose", "scale"),
        "Cameras, poses and scale",
        "Most scans that come out wrong have a wrong camera, a wrong pose convention or a wrong "
        "unit. `scanloom inspect` tries the usual pose conventions, and measures whether colour, "
        "depth and poses agree.",
    ),
    "recordings": Page(
        ("recording",),
        "Recordings: bags, .db3, .mcap, .sens, .r3d, videos",
        "One file holds all frames. Recordings are often cut short when a recorder is killed, so "
        "everything in them is checked before it is used.",
    ),
    "files": Page(
        ("file",),
        "Files: images, depth maps, archives, texts, paths",
        "The message begins with the file. One bad frame is skipped and counted, up to a share of"
        " all frames; a bad file that the whole scan needs ends the work.",
    ),
    "mesh-files": Page(
        ("mesh",),
        "Mesh files",
        "The message begins with the file. [Mesh formats](../formats/meshes.md) lists what is read of each.",
    ),
    "depth": Page(
        ("depth",),
        "Depth from pairs and views",
        "Diagnostics of [depth](../stages/depth.md). Holes in the depth maps become holes in the "
        "mesh, and errors become bumps.",
    ),
    "register-and-adjust": Page(
        ("structure", "register", "adjust"),
        "Registration and adjustment of poses",
        "Diagnostics of [structure](../stages/structure.md), [register](../stages/register.md) and "
        "[adjust](../stages/adjust.md). "
        "`path.ply` shows the path of the camera in the point cloud.",
    ),
    "fuse-and-clean": Page(
        ("fuse", "clean", "refine"),
        "Fusion, cleaning, refinement, checking",
        "Diagnostics of [fuse](../stages/fuse.md), [clean](../stages/clean.md), "
        "[refine](../stages/refine.md) and `scanloom check`.",
    ),
    "simplify": Page(
        ("simplify",),
        "Simplification, proofs, records",
        "Diagnostics of [simplify](../stages/simplify.md), `certify`, `tradeoff` and `replay`.",
    ),
    "texture-and-bake": Page(
        ("texture",),
        "Texture from photos, baked images",
        "Diagnostics of [texture](../stages/texture.md) and [bake](../stages/bake.md).",
    ),
    "levels": Page(
        ("levels",),
        "Normal meshes and levels of detail",
        "Diagnostics of [remesh](../stages/remesh.md), `decode`, [lod](../stages/lod.md) and "
        "[tiles](../stages/tiles.md).",
    ),
    "looking": Page(
        ("compare", "render", "report", "export", "coverage"),
        "Comparison, exports, pictures and pages",
        "Diagnostics of [compare](../comparing.md), [export](../exporting.md), "
        "[coverage](../what-is-missing.md), `render`, `view` and the page of a run.",
    ),
    "many-scans": Page(
        ("batch",),
        "Many scans",
        "Diagnostics of `scanloom batch` and `scanloom worker` about the whole "
        "[batch](../many-scans.md). Diagnostics of single scans are on the other pages.",
    ),
}


@dataclass(frozen=True)
class Message:
    """Message in the sources, with `…` in place of values.

    Attributes
    ----------
    constant : name of the constant of its code.
    file, line : position in the sources.
    """

    text: str
    constant: str
    file: str
    line: int


def find_codes() -> list[Code]:
    """List all codes in the order of their declarations."""
    for path in _find_sources():
        if path.name == "codes.py":
            importlib.import_module(".".join(("scanloom", *path.relative_to(ROOT).with_suffix("").parts)))
    # `get_declared_codes` has the order of imports, which is arbitrary.
    codes = get_declared_codes()
    return [codes[name] for name in find_constants().values()]


def find_constants() -> dict[str, str]:
    """Map the constant of each code to the code's name."""
    names = {}
    for path in _find_sources():
        if path.name == "codes.py":
            for node in ast.parse(path.read_text(encoding="utf-8")).body:
                match node:
                    case ast.Assign(
                        targets=[ast.Name(constant)], value=ast.Call(args=[ast.Constant(str(name)), *_])
                    ):
                        names[constant] = name
    return names


def find_messages() -> Iterator[Message]:
    """Yield the messages of all calls with a diagnostic code."""
    constants = find_constants()
    for path in _find_sources():
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            match node:
                # InputError(CODE, "…") and the like.
                case ast.Call(args=[ast.Name(constant), text, *_]) if constant in constants:
                    pass
                # CODE.warning("…") and the like.
                case ast.Call(func=ast.Attribute(ast.Name(constant)), args=[text, *_]) if (
                    constant in constants
                ):
                    pass
                case _:
                    continue
            for form in _expand_texts(text):
                yield Message(form, constant, path.relative_to(ROOT).as_posix(), node.lineno)


def find_page(name: str) -> str:
    """Return the name of the page that explains a code.

    Raises
    ------
    KeyError
        If no page has the topic of the code.
    """
    topic = name.partition(".")[0]
    for page, about in PAGE_TABLE.items():
        if topic in about.topics:
            return page
    raise KeyError(topic)


def write_page(name: str) -> str:
    """Write the Markdown of a page."""
    page = PAGE_TABLE[name]
    codes = [one for topic in page.topics for one in find_codes() if one.name.partition(".")[0] == topic]
    sections = [
        f"## {one.title}\n\n**{one.name}**\n\n```text\n{one.example}\n```\n\n{one.explanation.strip()}\n"
        for one in codes
    ]
    return "\n".join([f"# {page.title}\n\n{page.text}\n", *sections])


def _find_sources() -> list[Path]:
    found = [path for room in PACKAGES for path in sorted((ROOT / room).rglob("*.py"))]
    return [path for path in found if "node_modules" not in path.parts]


def _expand_texts(node: ast.expr) -> Iterator[str]:
    """Yield the possible texts of an expression, with `…` for values."""
    match node:
        case ast.Constant(str(text)):
            yield re.sub(r"\{[^{}]*\}", "…", text)
        case ast.JoinedStr(parts):
            yield "".join(str(one.value) if isinstance(one, ast.Constant) else "…" for one in parts)
        case ast.IfExp(body=one, orelse=other):
            yield from _expand_texts(one)
            yield from _expand_texts(other)


if __name__ == "__main__":
    for page in PAGE_TABLE:
        (PAGES / f"{page}.md").write_text(write_page(page), encoding="utf-8", newline="\n")
