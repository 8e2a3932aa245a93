"""Wavefront OBJ files with texture coordinates per corner.

trimesh reads the format too, but either splits the surface along texture seams or loses the coordinates
there, and refuses negative indices when told to keep the order of vertices. Curves, lines, points, groups
and smoothing are left out; all objects of a file become one mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.formats.colors import to_uint8
from stages.formats.polygons import split_polygons
from stages.formats.text_numbers import parse_numbers
from stages.formats.textures import beside, read_texture, write_images
from stages.mesh import Mesh, validated
from stages.replacing import replacing
from stages.texture import Material, Texture


@dataclass
class _Statements:
    """The file's lines, sorted by what they say; `seen` counts v, vt and vn before each face."""

    positions: list[bytes] = field(default_factory=list)
    uvs: list[bytes] = field(default_factory=list)
    normals: list[bytes] = field(default_factory=list)
    faces: list[bytes] = field(default_factory=list)
    seen: list[tuple[int, int, int]] = field(default_factory=list)
    materials: list[tuple[int, str]] = field(default_factory=list)  # first face, name
    libraries: list[str] = field(default_factory=list)


def read_obj(path: Path | str) -> Mesh:
    """Read an OBJ file; polygons are split into fans.

    Colours after the positions (0..1, or 0..255) are kept if every vertex has them, normals if they agree
    at every vertex, and images named by the material library become the Texture. `Mesh.notes` says what
    was changed or left out.

    Raises
    ------
    InputError
        If the file cannot be read or parsed.
    MeshError
        For a vertex that is not finite or an index out of range.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror}.", path) from error
    notes: list[str] = []
    statements = _sorted_statements(data)
    try:
        vertices, colors = _positions(statements.positions, notes)
        lengths, references = _references(statements.faces, statements.seen)
        uvs = _rows(statements.uvs, 2)
        normals = _rows(statements.normals, 3)
    except ValueError as error:
        raise InputError(f"cannot be parsed: {error}", path) from None
    corners, source = split_polygons(lengths, notes)
    corner_references = references[corners]
    triangles: Any = corner_references[..., 0]  # 64 bits until the range is checked
    mesh = validated(Mesh(vertices, triangles, colors), str(path))
    texture = _texture(corner_references[..., 1], uvs, source, statements, path.parent, notes)
    return mesh.with_(
        normals=_vertex_normals(mesh, corner_references[..., 2], normals, notes),
        texture=texture,
        notes=tuple(notes),
    )


def _sorted_statements(data: bytes) -> _Statements:
    statements = _Statements()
    by_key = {b"v": statements.positions, b"vt": statements.uvs, b"vn": statements.normals}
    for raw in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        line = raw.partition(b"#")[0] if b"#" in raw else raw
        words = line.split(None, 1)
        if len(words) < 2:
            continue
        key, rest = words
        if key in by_key:
            by_key[key].append(rest)
        elif key == b"f":
            statements.faces.append(rest)
            statements.seen.append((len(statements.positions), len(statements.uvs), len(statements.normals)))
        elif key == b"usemtl":
            statements.materials.append((len(statements.faces), _name(rest)))
        elif key == b"mtllib":
            statements.libraries.append(_name(rest))
    return statements


def _name(rest: bytes) -> str:
    return rest.decode("utf-8", "replace").strip()


def _positions(lines: list[bytes], notes: list[str]) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    table = _rows(lines, 3)
    if table.shape[1] in (6, 7):
        colors = table[:, -3:]
        if not np.isfinite(colors).all():
            notes.append("colours that are not finite are taken as 0")
        return table[:, :3], to_uint8(colors)
    if len(lines) and any(len(line.split()) >= 6 for line in lines):
        notes.append("colours are left out: some vertices have none")
    return table[:, :3], None


def _rows(lines: list[bytes], width: int) -> NDArray[np.float64]:
    """Parse lines of numbers; if they differ in length, the first `width` of each."""
    if not lines:
        return np.zeros((0, width))
    counts = np.array([len(line.split()) for line in lines])
    if counts.min() < width:
        raise ValueError(
            f"{lines[int(counts.argmin())][:60].decode('latin-1')!r} has fewer than {width} numbers."
        )
    if counts.min() != counts.max():
        lines = [b" ".join(line.split()[:width]) for line in lines]
    return parse_numbers(b"\n".join(lines)).reshape(len(lines), -1)


def _references(
    lines: list[bytes], seen: list[tuple[int, int, int]]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Parse face lines of corners `v`, `v/vt`, `v//vn` or `v/vt/vn`.

    Returns
    -------
    lengths : (faces,) corners of each.
    references : (corners, 3) zero-based v, vt, vn; -1 where a corner has none.
    """
    if not lines:
        return np.zeros(0, np.int64), np.zeros((0, 3), np.int64)
    text = b" " + b"\n".join(lines).replace(b"\t", b" ").replace(b"\r", b" ") + b" "
    text = text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/\n", b"/0\n")
    characters = np.frombuffer(text, np.uint8)
    blank = (characters == ord(" ")) | (characters == ord("\n"))
    begins = np.flatnonzero(blank[:-1] & ~blank[1:]) + 1
    numbers = parse_numbers(text.replace(b"/", b" "))
    slashes = np.add.reduceat(characters == ord("/"), begins, dtype=np.int64)
    whole = (np.abs(numbers) < 2**53).all() and not (numbers % 1).any()
    if not whole or len(numbers) != (slashes + 1).sum() or slashes.max() > 2:
        raise ValueError("a face has a corner that is not of the form v, v/vt, v//vn or v/vt/vn.")

    written = np.zeros((len(begins), 3), np.int64)
    first = np.cumsum(slashes + 1) - (slashes + 1)
    for part in range(3):
        has = slashes >= part
        written[has, part] = numbers[first[has] + part]
    line_of_corner = np.cumsum(characters == ord("\n"))[begins]
    lengths = np.bincount(line_of_corner, minlength=len(lines))
    before = np.array(seen, np.int64)[line_of_corner]
    # Negative numbers count back from the last one written before the face; 0 stands for none.
    references = np.where(written < 0, before + written, written - 1)
    # A position must be named: 0 is an error there, and so is counting back beyond the first.
    references[references[:, 0] < 0, 0] = -1
    return lengths, references


def _vertex_normals(
    mesh: Mesh, references: NDArray[np.int64], normals: NDArray[np.float64], notes: list[str]
) -> NDArray[np.float64] | None:
    if len(normals) == 0 or references.size == 0 or (references < 0).all():
        return None
    result = np.full((len(mesh.vertices), 3), np.nan)
    if (references < 0).any() or (references >= len(normals)).any():
        notes.append("normals are left out: some corners have none")
        return None
    corners = mesh.triangles.reshape(-1)
    wanted = normals[references.reshape(-1), :3]
    result[corners] = wanted
    if not np.array_equal(result[corners], wanted):
        notes.append("normals are left out: they differ from corner to corner")
        return None
    if not np.isfinite(result).all():
        notes.append("normals are left out: some vertices have none")
        return None
    return result


def _texture(
    references: NDArray[np.int64],
    uvs: NDArray[np.float64],
    source: NDArray[np.int64],
    statements: _Statements,
    folder: Path,
    notes: list[str],
) -> Texture | None:
    images, number_of = _images(statements, folder, notes)
    if not images or len(uvs) == 0:
        return None
    starts = np.array([first for first, _ in statements.materials], np.int64)
    numbers = np.array([number_of.get(name, -1) for _, name in statements.materials] + [-1], np.int32)
    material_ids = numbers[np.searchsorted(starts, source, side="right") - 1]
    in_range = np.all((references >= 0) & (references < len(uvs)), axis=1)
    corner_uvs = uvs[np.where(in_range[:, None], references, 0), :2]
    usable = in_range & np.all(np.isfinite(corner_uvs), axis=(1, 2))
    if (~usable & (material_ids >= 0)).any():
        notes.append("some triangles lose their texture: their texture coordinates are missing or not finite")
    corner_uvs[~usable] = 0
    return Texture(corner_uvs, np.where(usable, material_ids, -1).astype(np.int32), images)


def _images(
    statements: _Statements, folder: Path, notes: list[str]
) -> tuple[tuple[Material, ...], dict[str, int]]:
    """Return the images of the materials in use, and the number of each material's image."""
    used = {name for _, name in statements.materials}
    images: list[Material] = []
    numbers: dict[str, int] = {}
    by_file: dict[str, int | None] = {}
    for library in statements.libraries:
        for material, file in _maps(beside(folder, library)).items():
            if material not in used:
                continue
            if file not in by_file:
                image = read_texture(folder, file, notes)
                by_file[file] = None if image is None else len(images)
                if image is not None:
                    images.append(Material(image=image))
            number = by_file[file]
            if number is not None:
                numbers[material] = number
    return tuple(images), numbers


def _maps(library: Path) -> dict[str, str]:
    """Return the diffuse image of each material; nothing if the library is missing, which is common."""
    try:
        lines = library.read_text("utf-8", "replace").splitlines()
    except (OSError, ValueError):  # ValueError: a name with a zero byte.
        return {}
    maps: dict[str, str] = {}
    material = ""
    for line in lines:
        words = line.split(None, 1)
        if len(words) == 2 and words[0] == "newmtl":
            material = words[1].strip()
        elif len(words) == 2 and words[0] == "map_Kd":
            maps[material] = words[1].strip()
    return maps


def write_obj(path: Path | str, mesh: Mesh) -> None:
    """Write an OBJ file; a texture goes beside it as NAME.mtl and NAME_0.png, NAME_1.png, ….

    Numbers are written so that they read back equal. Each file appears whole or not at all.

    Raises
    ------
    StageError
        If the system refuses to write.
    """
    path = Path(path)
    lines: list[str] = []
    columns: list[NDArray[Any]] = [mesh.vertices]
    if mesh.colors is not None:
        columns.append(mesh.colors / 255)
    lines += _number_lines("v", np.hstack(columns))
    if mesh.normals is not None:
        lines += _number_lines("vn", mesh.normals)
    corners = mesh.triangles + 1
    vn = corners if mesh.normals is not None else None
    if mesh.texture is None or not mesh.texture.images:
        lines += _face_lines(corners, None, vn)
    else:
        texture = mesh.texture
        _write_materials(path, texture)
        lines.insert(0, f"mtllib {path.stem}.mtl")
        unique, index = np.unique(texture.uvs.reshape(-1, 2), axis=0, return_inverse=True)
        lines += _number_lines("vt", unique)
        vt = index.reshape(-1, 3) + 1
        order = np.argsort(texture.material_ids, kind="stable")
        for number in np.unique(texture.material_ids):
            chosen = order[texture.material_ids[order] == number]
            lines.append(f"usemtl material_{number}")
            lines += _face_lines(corners[chosen], vt[chosen], None if vn is None else vn[chosen])
    with replacing(path) as part:
        part.write_text("\n".join([*lines, ""]))


def _number_lines(key: str, rows: NDArray[np.float64]) -> list[str]:
    return [f"{key} {' '.join(map(repr, row))}" for row in rows.tolist()]


def _face_lines(v: NDArray[Any], vt: NDArray[Any] | None, vn: NDArray[Any] | None) -> list[str]:
    if vt is None and vn is None:
        return [f"f {a} {b} {c}" for a, b, c in v.tolist()]
    if vt is None:
        return [f"f {a}//{a} {b}//{b} {c}//{c}" for a, b, c in v.tolist()]
    if vn is None:
        pairs = zip(v.tolist(), vt.tolist(), strict=True)
        return [f"f {a}/{s} {b}/{t} {c}/{u}" for (a, b, c), (s, t, u) in pairs]
    pairs = zip(v.tolist(), vt.tolist(), strict=True)
    return [f"f {a}/{s}/{a} {b}/{t}/{b} {c}/{u}/{c}" for (a, b, c), (s, t, u) in pairs]


def _write_materials(path: Path, texture: Texture) -> None:
    lines = ["newmtl material_-1", "Kd 0.5 0.5 0.5"]
    names = write_images(path, texture.images)
    for number, material in enumerate(texture.materials):
        lines += [f"newmtl material_{number}", "Kd 1 1 1", f"map_Kd {names[id(material.image)]}"]
    with replacing(path.with_name(f"{path.stem}.mtl")) as part:
        part.write_text("\n".join([*lines, ""]))
