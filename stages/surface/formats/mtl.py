"""Material libraries (MTL) of OBJ files.

Source: Alias Wavefront, "MTL material format", 1995. Kd, d and map_Kd are interpreted. All statements are
kept unchanged for writing.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.surface.codes import MESH_COMPANION_MISSING, MESH_LEFT_OUT
from scanloom.stages.surface.formats.texture_files import read_texture, resolve_companion, write_images
from scanloom.stages.surface.texture import Image, Material

# Argument count of each texture-map option; -o, -s and -t take one to three numbers.
_OPTION_ARGUMENT_COUNTS = {
    "-blendu": 1, "-blendv": 1, "-boost": 1, "-mm": 2, "-texres": 1, "-clamp": 1, "-bm": 1, "-imfchan": 1,
    "-type": 1, "-cc": 1, "-colorspace": 1,
}  # fmt: skip
_PLACEMENT_OPTIONS = ("-o", "-s", "-t")
_MAP_PREFIXES = ("map_", "bump", "norm", "disp", "decal", "refl")
_DIFFUSE_MAP = "map_Kd"


@dataclass(frozen=True)
class TextureMap:
    """A parsed texture-map statement.

    Attributes
    ----------
    prefix : text before the file name, options included.
    file : image file name.
    options : arguments of each option.
    """

    prefix: str
    file: str
    options: dict[str, list[str]]


@dataclass(frozen=True, eq=False)
class MtlMaterialSource:
    """The original MTL statements of a material, for writing them back.

    Attributes
    ----------
    lines : statements, in file order.
    images : images of the texture maps by file name.
    color, image : the `Material` fields derived from the statements, to detect later changes.
    """

    lines: tuple[str, ...] = ()
    images: dict[str, Image] = field(default_factory=dict)
    color: tuple[float, float, float, float] | None = None
    image: Image | None = None


def decode_text(data: bytes) -> str:
    """Decode UTF-8 text, falling back to Latin-1."""
    try:
        return data.decode()
    except UnicodeDecodeError:
        return data.decode("latin-1")


def read_libraries(path: Path, libraries: Iterable[str], names: Iterable[str]) -> tuple[Material, ...]:
    """Read the named materials from the libraries of an OBJ file, each once.

    A missing library or image is reported as a warning. A material in no library gets a name but no
    properties.

    Parameters
    ----------
    path : OBJ file; file names are relative to its folder.
    libraries : arguments of the mtllib statements.
    names : material names in use.
    """
    statements: dict[str, list[str]] = {}
    for library in _split_library_names(path.parent, libraries):
        found = _read_statements(path.parent, library)
        if found is None:
            emit(
                MESH_COMPANION_MISSING.warning(
                    "the material library {library} is missing or cannot be read", path, library=library
                )
            )
            continue
        for name, lines in found.items():
            statements.setdefault(name, lines)
    images: dict[str, Image | None] = {}
    return tuple(
        _parse_material(path, name, statements[name], images) if name in statements else Material(name)
        for name in dict.fromkeys(names)
    )


def _split_library_names(folder: Path, libraries: Iterable[str]) -> list[str]:
    """Split mtllib arguments into file names.

    File names can contain spaces, and one statement can list several files.
    """
    files: dict[str, None] = {}
    for words in libraries:
        ends = [match.end() for match in re.finditer(r"\.mtl(?!\S)", words, re.IGNORECASE)]
        names = [words[a:b].strip() for a, b in zip([0, *ends], ends, strict=False)]
        names = [name for name in names if len(name) > len(".mtl")]
        is_single_name = _is_readable_file(resolve_companion(folder, words)) or len(names) < 2
        files.update(dict.fromkeys([words] if is_single_name else names))
    return list(files)


def _is_readable_file(file: Path) -> bool:
    try:
        return file.is_file()
    except (OSError, ValueError):  # ValueError: the name contains a null byte
        return False


def _read_statements(folder: Path, library: str) -> dict[str, list[str]] | None:
    try:
        lines = decode_text(read_input_bytes(resolve_companion(folder, library))).splitlines()
    except (OSError, ValueError):
        return None
    found: dict[str, list[str]] = {}
    current: list[str] = []
    for line in lines:
        words = line.split(None, 1)
        if words and words[0] == "newmtl":
            current = []
            found.setdefault(words[1].strip() if len(words) == 2 else "", current)
        elif words and not words[0].startswith("#"):
            current.append(line.strip())
    return found


def _parse_material(path: Path, name: str, lines: list[str], images: dict[str, Image | None]) -> Material:
    diffuse: list[float] | None = None
    alpha = 1.0
    images_by_file: dict[str, Image] = {}
    diffuse_map: TextureMap | None = None
    for line in lines:
        words = line.split()
        if words[0] == "Kd":
            diffuse = _parse_color(words[1:]) or diffuse
        elif words[0] == "d":
            alpha = (_parse_numbers(words[1:]) or [alpha])[0]
        elif words[0].startswith(_MAP_PREFIXES) and (found := _parse_map(line)) is not None:
            if found.file not in images:
                images[found.file] = read_texture(path, found.file)
            image = images[found.file]
            if image is not None:
                images_by_file[found.file] = image
            if words[0] == _DIFFUSE_MAP:
                diffuse_map = found
    image = images_by_file.get(diffuse_map.file) if diffuse_map else None
    if diffuse_map and image and any(option in diffuse_map.options for option in _PLACEMENT_OPTIONS):
        emit(
            MESH_LEFT_OUT.warning(
                "options -o, -s and -t of the image {image} are kept for writing, but ignored for colours",
                path,
                image=diffuse_map.file,
            )
        )
    color = None
    if image is None and diffuse is not None:
        color = (diffuse[0], diffuse[1], diffuse[2], min(max(alpha, 0.0), 1.0))
    wrap = (
        ("clamp", "clamp")
        if diffuse_map and diffuse_map.options.get("-clamp") == ["on"]
        else ("repeat", "repeat")
    )
    return Material(name, image, color, wrap, MtlMaterialSource(tuple(lines), images_by_file, color, image))


def _parse_numbers(words: list[str]) -> list[float] | None:
    try:
        return [float(word) for word in words]
    except ValueError:
        return None


def _parse_color(words: list[str]) -> list[float] | None:
    """Parse Kd to RGB 0 to 1; a single number is grey.

    The forms `Kd spectral` and `Kd xyz` are unused in practice and ignored.
    """
    numbers = _parse_numbers(words)
    if not numbers or len(numbers) == 2:
        return None
    return [min(max(value, 0.0), 1.0) for value in (numbers * 3 if len(numbers) == 1 else numbers)[:3]]


def _parse_map(line: str) -> TextureMap | None:
    """Parse a texture-map statement.

    The file name is the rest of the line after the options.
    """
    at = [(match.start(), match.group()) for match in re.finditer(r"\S+", line)]
    options: dict[str, list[str]] = {}
    k = 1
    while k < len(at) - 1:
        word = at[k][1]
        if word in _PLACEMENT_OPTIONS:
            count = 0
            while (
                count < 3 and k + count + 2 < len(at) and _parse_numbers([at[k + count + 1][1]]) is not None
            ):
                count += 1
        elif word in _OPTION_ARGUMENT_COUNTS:
            count = _OPTION_ARGUMENT_COUNTS[word]
        else:
            break
        options[word] = [value for _, value in at[k + 1 : k + 1 + count]]
        k += 1 + count
    if k >= len(at):
        return None
    start = at[k][0]
    return TextureMap(line[:start], line[start:], options)


def write_library(path: Path, materials: Sequence[Material], names: list[str]) -> None:
    """Write materials and their images next to an OBJ file.

    The library is named after the OBJ file `path`, with the extension .mtl.
    """
    images: dict[int, Image] = {}
    for material in materials:
        kept = _get_source(material).images.values()
        images.update({id(image): image for image in (material.image, *kept) if image is not None})
    files = write_images(path, images.values())
    lines: list[str] = []
    for material, name in zip(materials, names, strict=True):
        lines += [f"newmtl {name}", *_format_material(material, files)]
    with write_file_atomically(path.with_name(f"{path.stem}.mtl")) as part:
        part.write_text("\n".join([*lines, ""]), encoding="utf-8", newline="\n")


def _get_source(material: Material) -> MtlMaterialSource:
    return material.kept if isinstance(material.kept, MtlMaterialSource) else MtlMaterialSource()


def _format_material(material: Material, files: dict[int, str]) -> list[str]:
    """Return a material's statements: the original ones, updated where fields changed."""
    kept = _get_source(material)
    same_color, same_image = material.base_color == kept.color, material.image is kept.image
    lines = []
    for line in kept.lines:
        key = line.split(None, 1)[0]
        if (key in ("Kd", "d", "Tr") and not same_color) or (key == _DIFFUSE_MAP and not same_image):
            continue
        found = _parse_map(line) if key.startswith(_MAP_PREFIXES) else None
        if found is not None and found.file in kept.images:
            line = found.prefix + files[id(kept.images[found.file])]
        lines.append(line)
    if material.base_color is not None and not same_color:
        red, green, blue, alpha = map(float, material.base_color)
        lines += [f"Kd {red!r} {green!r} {blue!r}", f"d {alpha!r}"]
    if material.image is not None and not same_image:
        # Some programs default the diffuse colour to black.
        if not any(line.startswith("Kd") for line in lines):
            lines.append("Kd 1 1 1")
        clamp = "-clamp on " if material.wrap == ("clamp", "clamp") else ""
        lines.append(f"{_DIFFUSE_MAP} {clamp}{files[id(material.image)]}")
    return lines
