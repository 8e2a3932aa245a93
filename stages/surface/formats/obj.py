"""Wavefront OBJ reader and writer with texture coordinates per corner.

trimesh's reader either splits the surface along texture seams or loses seam coordinates. It also refuses
negative indices when it keeps the vertex order. Curves, lines, points and smoothing groups are dropped;
objects and groups become parts of one mesh.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import collecting, emit
from scanloom.stages.diagnostics.errors import InputError, MeshError
from scanloom.stages.files.atomic_files import write_file_atomically
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.files.text_numbers import parse_integers, parse_numbers
from scanloom.stages.surface.codes import (
    MESH_FILE_DAMAGED,
    MESH_LEFT_OUT,
    MESH_TEXTURE_DAMAGED,
    MESH_VALUES_REPLACED,
)
from scanloom.stages.surface.formats.color_conversion import to_uint8
from scanloom.stages.surface.formats.mtl import read_libraries, write_library
from scanloom.stages.surface.formats.obj_statements import (
    NO_PART_NAME,
    ObjStatements,
    find_words,
    sort_statements,
)
from scanloom.stages.surface.formats.polygon_triangulation import triangulate_polygons
from scanloom.stages.surface.mesh import Mesh, require_writable, validate_mesh
from scanloom.stages.surface.texture import Material, Texture
from scanloom.stages.surface.welding import find_first_equal_rows

# Names that programs write for faces without a material.
_NO_MATERIAL_NAMES = ("None", "(null)")
# Lines formatted per string operation.
_LINES_PER_BLOCK = 1 << 15
# Corner formats, indexed by 2 (has a texture coordinate) plus 1 (has a normal).
_CORNER_FORMATS = ("%d", "%d//%d", "%d/%d", "%d/%d/%d")


def read_obj(path: Path | str) -> Mesh:
    """Read an OBJ file and triangulate its polygons.

    Colours after positions (0 to 1, or 0 to 255) are kept if every vertex has one. Normals become vertex
    normals if all corners of a vertex agree, else corner normals. Materials come from the available
    libraries, and images are kept unchanged. `Mesh.diagnostics` lists changed, dropped and missing data.

    Raises
    ------
    InputError
        If the file cannot be read or parsed.
    MeshError
        If a vertex is not finite or an index is out of range.
    """
    with collecting() as diagnostics:
        mesh = _read_file(Path(path))
    return mesh.with_(diagnostics=tuple(diagnostics))


def _read_file(path: Path) -> Mesh:
    try:
        data = read_input_bytes(path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {strerror}.", path, strerror=error.strerror
        ) from error
    statements = sort_statements(data)
    if statements.unsupported:
        others = " and ".join(sorted(statements.unsupported))
        emit(MESH_LEFT_OUT.warning("{others} are left out", path, others=others))
    try:
        vertices, colors = _parse_positions(statements.positions, path)
        lengths, references = _parse_references(statements.faces, statements.counts_before_face)
        uvs, _ = _parse_rows(statements.uvs, 2, path)
        normals, _ = _parse_rows(statements.normals, 3, path)
    except ValueError as error:
        raise InputError(MESH_FILE_DAMAGED, "cannot be parsed: {error}", path, error=error) from None
    corners, source = triangulate_polygons(lengths, references[:, 0], vertices, path)
    corner_references = references[corners]
    triangles: Any = corner_references[..., 0]  # 64 bits until the range is checked
    mesh = validate_mesh(Mesh(vertices, triangles, colors), str(path))
    texture = _build_texture(corner_references[..., 1], uvs, source, statements, path)
    vertex_normals, corner_normals = _assign_normals(mesh, corner_references[..., 2], normals, path)
    part_names = tuple(
        name for name in _find_used_names(statements.parts, len(lengths)) if name != NO_PART_NAME
    )
    return mesh.with_(
        normals=vertex_normals,
        corner_normals=corner_normals,
        texture=texture,
        part_ids=_assign_name_indices(statements.parts, part_names, source) if part_names else None,
        part_names=part_names,
    )


def _parse_positions(text: bytes, path: Path) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    table, counts = _parse_rows(text, 3, path)
    if table.shape[1] in (6, 7):
        colors = table[:, -3:]
        if not np.isfinite(colors).all():
            emit(MESH_VALUES_REPLACED.warning("colours that are not finite become black", path))
        return table[:, :3], to_uint8(colors)
    if (counts >= 6).any():
        emit(MESH_LEFT_OUT.warning("colours are left out: some vertices have none", path))
    return table[:, :3], None


def _parse_rows(text: bytes, width: int, path: Path) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Parse lines of numbers to a table, and count the numbers per line.

    If lines differ in length, the table has the first `width` numbers of each.
    """
    counts = find_words(text)[1]
    if not len(counts):
        return np.zeros((0, width)), counts
    if counts.min() < width:
        line = text.split(b"\n")[int(counts.argmin())].strip()
        raise InputError(
            MESH_FILE_DAMAGED,
            "cannot be parsed: {line!r} has fewer than {width} numbers.",
            path,
            line=line[:60].decode("latin-1"),
            width=width,
        )
    numbers = text
    if counts.min() != counts.max():
        numbers = b"\n".join(b" ".join(line.split()[:width]) for line in text.split(b"\n"))
    return parse_numbers(numbers).reshape(len(counts), -1), counts


def _parse_references(
    text: bytes, counts_before: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Parse faces with corners `v`, `v/vt`, `v//vn` or `v/vt/vn`.

    Parameters
    ----------
    text : face lines without the keyword.
    counts_before : (faces, 3) number of v, vt and vn statements before each face.

    Returns
    -------
    lengths : (faces,) corner count of each face.
    references : (corners, 3) zero-based indices v, vt, vn; -1 if a corner has none.
    """
    if not text:
        return np.zeros(0, np.int64), np.zeros((0, 3), np.int64)
    if b"/" in text:
        text = text.replace(b"//", b"/0/").replace(b"/ ", b"/0 ").replace(b"/\n", b"/0\n")
        text = text + b"0" if text.endswith(b"/") else text
    begins, lengths = find_words(text)
    slashes = np.zeros(len(begins), np.int64)
    if b"/" in text:
        at = np.flatnonzero(np.frombuffer(text, np.uint8) == ord("/"))
        slashes = np.bincount(np.searchsorted(begins, at, side="right") - 1, minlength=len(begins))
        text = text.replace(b"/", b" ")
    numbers = parse_integers(text)
    if numbers is None or len(numbers) != (slashes + 1).sum() or slashes.max() > 2:
        raise ValueError("a face has a corner that is not of the form v, v/vt, v//vn or v/vt/vn.")

    written = np.zeros((len(begins), 3), np.int64)
    if slashes.min() == slashes.max():
        written[:, : slashes[0] + 1] = numbers.reshape(len(begins), -1)
    else:
        first = np.cumsum(slashes + 1) - (slashes + 1)
        for part in range(3):
            has = slashes >= part
            written[has, part] = numbers[first[has] + part]
    references = written - 1
    if (written < 0).any():
        # A negative index counts back from the last element before the face. 0 means no index.
        references = np.where(written < 0, np.repeat(counts_before, lengths, axis=0) + written, references)
    # The position index is required, so 0 and a negative index out of range are errors.
    references[references[:, 0] < 0, 0] = -1
    return lengths, references


def _assign_normals(
    mesh: Mesh, references: NDArray[np.int64], normals: NDArray[np.float64], path: Path
) -> tuple[NDArray[np.float64] | None, NDArray[np.float64] | None]:
    """Return vertex normals, or corner normals if a vertex has several.

    A corner without a normal gets 0.
    """
    has_normal = (references >= 0) & (references < len(normals))
    if not has_normal.any():
        return None, None
    corner_normals = normals[np.where(has_normal, references, 0), :3]
    corner_normals[~has_normal] = 0
    finite = np.isfinite(corner_normals).all(axis=2)
    if not finite.all():
        emit(MESH_LEFT_OUT.warning("normals that are not finite are left out", path))
        corner_normals[~finite] = 0
    vertex_normals = np.full((len(mesh.vertices), 3), np.nan)
    vertex_normals[mesh.triangles] = corner_normals
    if np.array_equal(vertex_normals[mesh.triangles], corner_normals) and np.isfinite(vertex_normals).all():
        return vertex_normals, None
    return None, corner_normals


def _find_used_names(changes: list[tuple[int, str]], face_count: int) -> tuple[str, ...]:
    """Return the names in use, in order of first use."""
    ends = [first for first, _ in changes[1:]] + [face_count]
    return tuple(
        dict.fromkeys(name for (first, name), end in zip(changes, ends, strict=False) if first < end)
    )


def _assign_name_indices(
    changes: list[tuple[int, str]], names: tuple[str, ...], source: NDArray[np.int64]
) -> Any:
    """Return each triangle's name index (m,) int32.

    It is -1 for other names and before the first one.
    """
    number_of = {name: number for number, name in enumerate(names)}
    starts = np.array([first for first, _ in changes], np.int64)
    numbers = np.array([number_of.get(name, -1) for _, name in changes] + [-1], np.int32)
    return numbers[np.searchsorted(starts, source, side="right") - 1]


def _build_texture(
    references: NDArray[np.int64],
    uvs: NDArray[np.float64],
    source: NDArray[np.int64],
    statements: ObjStatements,
    path: Path,
) -> Texture | None:
    names = _find_used_names(statements.materials, len(statements.counts_before_face))
    materials = read_libraries(path, statements.libraries, names)
    # Drop placeholder names for "no material", unless a library defines them.
    materials = tuple(m for m in materials if m.kept is not None or m.name not in _NO_MATERIAL_NAMES)
    names = tuple(material.name for material in materials)
    given = np.all((references >= 0) & (references < len(uvs)), axis=1)
    if not names and not given.any():
        return None
    material_ids = _assign_name_indices(statements.materials, names, source)
    corner_uvs = np.zeros((len(references), 3, 2))
    corner_uvs[given] = uvs[references[given], :2]
    finite = np.isfinite(corner_uvs).all(axis=(1, 2))
    corner_uvs[~finite] = 0
    has_image = np.array([material.image is not None for material in materials] + [False])
    lost = np.count_nonzero(has_image[material_ids] & ~(given & finite)) or np.count_nonzero(~finite)
    if lost:
        emit(
            MESH_TEXTURE_DAMAGED.warning(
                "{count:,} triangles lose their texture: their texture coordinates are missing or not finite",
                path,
                count=lost,
            )
        )
    return Texture(corner_uvs, material_ids, materials)


def write_obj(path: Path | str, mesh: Mesh) -> None:
    """Write an OBJ file, its material library (NAME.mtl) and its images.

    Images keep their names and bytes. Numbers are written so that they read back equal, and triangles keep
    their order. Each file is replaced atomically.

    Raises
    ------
    MeshError
        If coordinates are not finite.
    StageError
        If a file cannot be written.
    """
    path = Path(path)
    require_writable(mesh, path)
    texture = mesh.texture
    columns: list[NDArray[Any]] = [mesh.vertices]
    if mesh.colors is not None:
        # Only 256 values occur, so each is formatted once.
        columns.append(np.array([repr(level / 255) for level in range(256)], object)[mesh.colors])
    texts = _format_rows("v", columns)
    corners = mesh.triangles.astype(np.int64) + 1
    vt = vn = None
    if texture is not None and (has_uvs := texture.has_uvs()).any():
        coordinates, vt = _deduplicate_rows(texture.uvs.reshape(-1, 2))
        vt[~has_uvs] = 0
        texts += _format_rows("vt", [coordinates])
    if mesh.corner_normals is not None:
        directions, vn = _deduplicate_rows(mesh.corner_normals.reshape(-1, 3))
        vn[(mesh.corner_normals == 0).all(axis=2)] = 0
        texts += _format_rows("vn", [directions])
    elif mesh.normals is not None:
        texts += _format_rows("vn", [mesh.normals])
        vn = corners
    names: list[str] = []
    if texture is not None and texture.materials:
        names = _make_names_unique([material.name for material in texture.materials])
        texts.insert(0, f"mtllib {path.stem}.mtl\n")
        write_library(
            path, [_replace_redundant_clamp(texture, number) for number in range(len(names))], names
        )
    texts += _format_faces(corners, vt, vn, _format_statements(mesh, names))
    with write_file_atomically(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        file.writelines(texts)


def _replace_redundant_clamp(texture: Texture, number: int) -> Material:
    """Return a material, with wrap mode "repeat" instead of "clamp" where both look equal.

    They look equal if all coordinates are at least half a texel inside the image. Many programs fail to load
    an image whose name follows the `-clamp` option.
    """
    material = texture.materials[number]
    if material.image is None or material.wrap != ("clamp", "clamp"):
        return material
    try:
        height, width = material.image.pixels.shape[:2]
    except MeshError:
        return material
    texels = texture.uvs[texture.material_ids == number] * (width, height)
    is_inside = ((texels >= 0.5) & (texels <= (width - 0.5, height - 0.5))).all()
    return replace(material, wrap=("repeat", "repeat")) if is_inside else material


def _deduplicate_rows(rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Deduplicate rows in order of first use; return them and one-based indices (m, 3)."""
    first = find_first_equal_rows(list(rows.T))
    is_first = first == np.arange(len(rows))
    return rows[is_first], np.cumsum(is_first)[first].reshape(-1, 3)


def _make_names_unique(names: list[str]) -> list[str]:
    """Return unique names without line breaks."""
    found: dict[str, None] = {}
    for name in names:
        base = " ".join(name.split()) or "unnamed"
        distinct, number = base, 1
        while distinct in found:
            number += 1
            distinct = f"{base}_{number}"
        found[distinct] = None
    return list(found)


def _format_statements(mesh: Mesh, materials: list[str]) -> dict[int, str]:
    """Return the part and material statements to write before each triangle index."""
    words: list[tuple[NDArray[np.int32], list[str]]] = []
    # The last statement of each list is addressed by -1, the index of no part and no material.
    if materials and mesh.texture is not None:
        none = next(name for name in (*_NO_MATERIAL_NAMES, "") if name not in materials)
        words.append((mesh.texture.material_ids, [f"usemtl {name}\n" for name in (*materials, none)]))
    if mesh.part_ids is not None:
        # Written as object and as group, because programs read one or the other.
        parts = [f"o {name}\ng {name}\n" for name in _make_names_unique(list(mesh.part_names))]
        words.append((mesh.part_ids, [*parts, f"g {NO_PART_NAME}\n"]))
    found: dict[int, str] = {}
    for ids, statements in words:
        for start in np.flatnonzero(np.diff(ids, prepend=-1)).tolist():
            found[start] = statements[ids[start]] + found.get(start, "")
    return found


def _format_rows(key: str, columns: list[NDArray[Any]]) -> list[str]:
    width = sum(column.shape[1] for column in columns)
    line = f"{key}{' %s' * width}\n"
    texts = []
    for start in range(0, len(columns[0]), _LINES_PER_BLOCK):
        rows = [column[start : start + _LINES_PER_BLOCK] for column in columns]
        # One flat list, because a list per line would double the time.
        flat = rows[0] if len(rows) == 1 else np.hstack([row.astype(object) for row in rows])
        texts.append(line * len(flat) % tuple(flat.ravel().tolist()))
    return texts


def _format_faces(
    v: NDArray[np.int64],
    vt: NDArray[np.int64] | None,
    vn: NDArray[np.int64] | None,
    statements: dict[int, str],
) -> list[str]:
    """Format face lines, preceded by their statements; index 0 means absent."""
    none = np.zeros_like(v)
    indices = np.stack([v, none if vt is None else vt, none if vn is None else vn], axis=2)
    # Format code of each triangle; consecutive triangles with equal codes are formatted together.
    kinds = (2 * (indices[..., 1] > 0) + (indices[..., 2] > 0)) @ np.array([16, 4, 1])
    if not len(v):
        return []
    breaks = {
        *statements,
        *(np.flatnonzero(np.diff(kinds)) + 1).tolist(),
        *range(0, len(v), _LINES_PER_BLOCK),
    }
    starts = sorted(breaks)
    texts = []
    for start, end in zip(starts, [*starts[1:], len(v)], strict=True):
        kind = int(kinds[start])
        corners = [kind >> shift & 3 for shift in (4, 2, 0)]
        line = f"f {' '.join(_CORNER_FORMATS[corner] for corner in corners)}\n"
        used = [has for corner in corners for has in (True, corner >= 2, corner % 2 == 1)]
        flat = indices[start:end].reshape(-1, 9)[:, used].ravel().tolist()
        texts.append(statements.get(start, "") + line * (end - start) % tuple(flat))
    return texts
