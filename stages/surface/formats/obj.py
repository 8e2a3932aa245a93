"""Wavefront OBJ files with texture coordinates per corner.

trimesh reads the format too, but either splits the surface along texture seams or loses the coordinates
there, and refuses negative indices when told to keep the order of vertices. Curves, lines, points and
smoothing are left out; all objects and groups of a file become parts of one mesh.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.errors import InputError
from stages.files.replacing import replacing
from stages.files.text_numbers import parse_numbers
from stages.surface.formats.colors import to_uint8
from stages.surface.formats.mtl import read_libraries, text_of, write_library
from stages.surface.formats.polygons import split_polygons
from stages.surface.mesh import Mesh, validated
from stages.surface.texture import Texture
from stages.surface.welding import same_rows

# What programs write for a material, or a group, that is none.
_NO_MATERIAL = ("None", "(null)")
_NO_PART = "default"


@dataclass
class _Statements:
    """The file's lines, sorted by what they say; `seen` counts v, vt and vn before each face."""

    positions: list[bytes] = field(default_factory=list)
    uvs: list[bytes] = field(default_factory=list)
    normals: list[bytes] = field(default_factory=list)
    faces: list[bytes] = field(default_factory=list)
    seen: list[tuple[int, int, int]] = field(default_factory=list)
    materials: list[tuple[int, str]] = field(default_factory=list)  # first face, name
    parts: list[tuple[int, str]] = field(default_factory=list)  # likewise
    libraries: list[str] = field(default_factory=list)


def read_obj(path: Path | str) -> Mesh:
    """Read an OBJ file; polygons are split into triangles.

    Colours after the positions (0..1, or 0..255) are kept if every vertex has them. Normals are those of
    vertices if they agree at every vertex, else of corners. Materials come from the libraries that are there,
    images as they are. `Mesh.notes` says what was changed, left out or missing.

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
    corners, source = split_polygons(lengths, references[:, 0], vertices, notes)
    corner_references = references[corners]
    triangles: Any = corner_references[..., 0]  # 64 bits until the range is checked
    mesh = validated(Mesh(vertices, triangles, colors), str(path))
    texture = _texture(corner_references[..., 1], uvs, source, statements, path.parent, notes)
    of_vertices, of_corners = _normals(mesh, corner_references[..., 2], normals, notes)
    part_names = tuple(name for name in _used(statements.parts, len(lengths)) if name != _NO_PART)
    return mesh.with_(
        normals=of_vertices,
        corner_normals=of_corners,
        texture=texture,
        part_ids=_ids(statements.parts, part_names, source) if part_names else None,
        part_names=part_names,
        notes=tuple(notes),
    )


def _sorted_statements(data: bytes) -> _Statements:
    statements = _Statements()
    by_key = {b"v": statements.positions, b"vt": statements.uvs, b"vn": statements.normals}
    names = {b"o": "", b"g": ""}
    for raw in data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        line = raw.partition(b"#")[0] if b"#" in raw else raw
        words = line.split(None, 1)
        if len(words) < 2:
            if words and words[0] in names:
                words.append(b"")
            else:
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
        elif key in names:
            if key == b"o":
                names[b"g"] = ""
            names[key] = _name(rest)
            part = "/".join(dict.fromkeys(name for name in names.values() if name))
            statements.parts.append((len(statements.faces), part or _NO_PART))
    return statements


def _name(rest: bytes) -> str:
    return text_of(rest).strip()


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


def _normals(
    mesh: Mesh, references: NDArray[np.int64], normals: NDArray[np.float64], notes: list[str]
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Return normals of the vertices, or of the corners where a vertex has several; 0 where one has none."""
    given = (references >= 0) & (references < len(normals))
    if not given.any():
        return None, None
    of_corners = normals[np.where(given, references, 0), :3]
    of_corners[~given] = 0
    finite = np.isfinite(of_corners).all(axis=2)
    if not finite.all():
        notes.append("normals that are not finite are left out")
        of_corners[~finite] = 0
    of_vertices = np.full((len(mesh.vertices), 3), np.nan)
    of_vertices[mesh.triangles] = of_corners
    if np.array_equal(of_vertices[mesh.triangles], of_corners) and np.isfinite(of_vertices).all():
        return of_vertices, None
    return None, of_corners


def _used(changes: list[tuple[int, str]], face_count: int) -> tuple[str, ...]:
    """Return the names that hold for some face, in the order of their first ones."""
    ends = [first for first, _ in changes[1:]] + [face_count]
    return tuple(
        dict.fromkeys(name for (first, name), end in zip(changes, ends, strict=False) if first < end)
    )


def _ids(changes: list[tuple[int, str]], names: tuple[str, ...], source: NDArray[np.int64]) -> Any:
    """Return (m,) int32 which of the names holds for each triangle; -1 for others and before the first."""
    number_of = {name: number for number, name in enumerate(names)}
    starts = np.array([first for first, _ in changes], np.int64)
    numbers = np.array([number_of.get(name, -1) for _, name in changes] + [-1], np.int32)
    return numbers[np.searchsorted(starts, source, side="right") - 1]


def _texture(
    references: NDArray[np.int64],
    uvs: NDArray[np.float64],
    source: NDArray[np.int64],
    statements: _Statements,
    folder: Path,
    notes: list[str],
) -> Texture | None:
    names = _used(statements.materials, len(statements.faces))
    materials = read_libraries(folder, statements.libraries, names, notes)
    # A name of no library that stands for no material.
    materials = tuple(m for m in materials if m.kept is not None or m.name not in _NO_MATERIAL)
    names = tuple(material.name for material in materials)
    given = np.all((references >= 0) & (references < len(uvs)), axis=1)
    if not names and not given.any():
        return None
    material_ids = _ids(statements.materials, names, source)
    corner_uvs = np.zeros((len(references), 3, 2))
    corner_uvs[given] = uvs[references[given], :2]
    finite = np.isfinite(corner_uvs).all(axis=(1, 2))
    corner_uvs[~finite] = 0
    has_image = np.array([material.image is not None for material in materials] + [False])
    lost = np.count_nonzero(has_image[material_ids] & ~(given & finite)) or np.count_nonzero(~finite)
    if lost:
        notes.append(
            f"{lost:,} triangles lose their texture: their texture coordinates are missing or not finite"
        )
    return Texture(corner_uvs, material_ids, materials)


def write_obj(path: Path | str, mesh: Mesh) -> None:
    """Write an OBJ file; materials go beside it as NAME.mtl, images under their own names, untouched.

    Numbers are written so that they read back equal, and triangles keep their order. Each file appears whole
    or not at all.

    Raises
    ------
    StageError
        If the system refuses to write.
    """
    path = Path(path)
    texture = mesh.texture
    columns: list[NDArray[Any]] = [mesh.vertices]
    if mesh.colors is not None:
        columns.append(mesh.colors / 255)
    lines = _number_lines("v", np.hstack(columns))
    corners = mesh.triangles.astype(np.int64) + 1
    vt = vn = None
    if texture is not None and (has_uvs := texture.has_uvs()).any():
        coordinates, vt = _numbered(texture.uvs.reshape(-1, 2))
        vt[~has_uvs] = 0
        lines += _number_lines("vt", coordinates)
    if mesh.corner_normals is not None:
        directions, vn = _numbered(mesh.corner_normals.reshape(-1, 3))
        vn[(mesh.corner_normals == 0).all(axis=2)] = 0
        lines += _number_lines("vn", directions)
    elif mesh.normals is not None:
        lines += _number_lines("vn", mesh.normals)
        vn = corners
    names: list[str] = []
    if texture is not None and texture.materials:
        names = _distinct([material.name for material in texture.materials])
        lines.insert(0, f"mtllib {path.stem}.mtl")
        write_library(path, texture.materials, names)
    faces = _face_lines(corners, vt, vn)
    lines += _with_statements(faces, mesh, names)
    with replacing(path) as part:
        part.write_text("\n".join([*lines, ""]), "utf-8")


def _numbered(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the distinct rows in the order in which they come, and (m, 3) which each corner has, from 1."""
    first = same_rows(list(rows.T))
    is_first = first == np.arange(len(rows))
    return rows[is_first], np.cumsum(is_first)[first].reshape(-1, 3)


def _distinct(names: list[str]) -> list[str]:
    """Return names that differ, and hold no line break."""
    found: dict[str, None] = {}
    for name in names:
        base = " ".join(name.split()) or "unnamed"
        distinct, number = base, 1
        while distinct in found:
            number += 1
            distinct = f"{base}_{number}"
        found[distinct] = None
    return list(found)


def _with_statements(faces: list[str], mesh: Mesh, materials: list[str]) -> list[str]:
    """Put the names of parts and materials before the faces that they hold for."""
    words: list[tuple[NDArray[np.int32], list[str]]] = []
    # The last statement of each list is for an index of -1.
    if materials and mesh.texture is not None:
        none = next(name for name in (*_NO_MATERIAL, "") if name not in materials)
        words.append((mesh.texture.material_ids, [f"usemtl {name}" for name in (*materials, none)]))
    if mesh.part_ids is not None:
        # As object and as group, since programs look for one or the other.
        parts = [f"o {name}\ng {name}" for name in _distinct(list(mesh.part_names))]
        words.append((mesh.part_ids, [*parts, f"g {_NO_PART}"]))
    for ids, statements in words:
        starts = np.flatnonzero(np.diff(ids, prepend=-1))
        for start in starts.tolist():
            faces[start] = f"{statements[ids[start]]}\n{faces[start]}"
    return faces


def _number_lines(key: str, rows: NDArray[np.float64]) -> list[str]:
    return [f"{key} {' '.join(map(repr, row))}" for row in rows.tolist()]


def _face_lines(v: NDArray[Any], vt: NDArray[np.int64] | None, vn: NDArray[np.int64] | None) -> list[str]:
    """Return lines of corners; an index of 0 stands for none."""
    if vt is None and vn is None:
        return [f"f {a} {b} {c}" for a, b, c in v.tolist()]
    if vt is not None and vn is None and vt.all():
        pairs = zip(v.tolist(), vt.tolist(), strict=True)
        return [f"f {a}/{s} {b}/{t} {c}/{u}" for (a, b, c), (s, t, u) in pairs]
    none = np.zeros_like(v)
    rows = np.hstack((v, none if vt is None else vt, none if vn is None else vn)).tolist()
    if vt is not None and vn is not None and vt.all() and vn.all():
        return [f"f {a}/{s}/{i} {b}/{t}/{j} {c}/{u}/{k}" for a, b, c, s, t, u, i, j, k in rows]
    return [
        f"f {_corner(a, s, i)} {_corner(b, t, j)} {_corner(c, u, k)}" for a, b, c, s, t, u, i, j, k in rows
    ]


def _corner(v: int, vt: int, vn: int) -> str:
    if not vn:
        return f"{v}/{vt}" if vt else f"{v}"
    return f"{v}/{vt or ''}/{vn}"
