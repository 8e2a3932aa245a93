"""Parser that sorts the statements of an OBJ file by keyword.

Nearly all lines are numbers of four kinds (v, vt, vn, f). They are found and extracted with array operations.
Only other lines, and files with unusual layout, are parsed line by line.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.surface.formats.mtl import decode_text

# Group name that programs write for faces without a group.
NO_PART_NAME = "default"

# Keywords of geometry other than triangles, with their names in messages.
UNSUPPORTED_KEYWORDS = {
    b"l": "lines",
    b"p": "points",
    b"curv": "curves",
    b"curv2": "curves",
    b"surf": "free-form surfaces",
}

_KEYWORDS = (b"v", b"vt", b"vn", b"f")
_FACE_KIND = _KEYWORDS.index(b"f")
# White space within a line, normalized to spaces.
_BLANKS = bytes.maketrans(b"\t\v\f", b"   ")
_IS_BLANK = np.isin(np.arange(256), list(b" \t\v\f"))


@dataclass
class ObjStatements:
    """The lines of an OBJ file, sorted by keyword.

    Attributes
    ----------
    positions, uvs, normals, faces : lines of v, vt, vn and f without the keyword, separated by line feeds;
        all
        other white space is spaces.
    counts_before_face : (faces, 3) number of v, vt and vn statements before each face.
    materials, parts : (index of the first face, name) of each change of material or part.
    libraries : arguments of the mtllib statements.
    unsupported : names from OTHERS of unsupported geometry in the file.
    """

    positions: bytes = b""
    uvs: bytes = b""
    normals: bytes = b""
    faces: bytes = b""
    counts_before_face: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, 3), np.int64))
    materials: list[tuple[int, str]] = field(default_factory=list)
    parts: list[tuple[int, str]] = field(default_factory=list)
    libraries: list[str] = field(default_factory=list)
    unsupported: set[str] = field(default_factory=set)
    _current_names: dict[bytes, str] = field(default_factory=lambda: {b"o": "", b"g": ""})

    def add(self, line: bytes, face_count: int) -> None:
        """Record a statement other than v, vt, vn or f.

        Parameters
        ----------
        line : the statement.
        face_count : number of faces before the line.
        """
        words = line.split(None, 1)
        if len(words) < 2:
            if not words or words[0] not in self._current_names:
                return
            words.append(b"")
        key, rest = words
        if key == b"usemtl":
            self.materials.append((face_count, _decode_name(rest)))
        elif key == b"mtllib":
            self.libraries.append(_decode_name(rest))
        elif key in UNSUPPORTED_KEYWORDS:
            self.unsupported.add(UNSUPPORTED_KEYWORDS[key])
        elif key in self._current_names:
            if key == b"o":
                self._current_names[b"g"] = ""
            self._current_names[key] = _decode_name(rest)
            part = "/".join(dict.fromkeys(name for name in self._current_names.values() if name))
            self.parts.append((face_count, part or NO_PART_NAME))


def _decode_name(rest: bytes) -> str:
    return decode_text(rest).strip()


def sort_statements(data: bytes) -> ObjStatements:
    """Sort the lines of an OBJ file by keyword."""
    if b"\\" in data:
        data = data.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if not data.endswith(b"\n"):
        data += b"\n"
    return _sort_in_bulk(data) or _sort_line_by_line(data)


def find_words(text: bytes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the offset of each word in a text, and the word count of each line."""
    if not text:
        return np.zeros(0, np.int64), np.zeros(0, np.int64)
    characters = np.frombuffer(text, np.uint8)
    # All separators have codes up to the space character.
    is_word = characters > ord(" ")
    begins = np.flatnonzero(is_word[1:] & ~is_word[:-1]) + 1
    if is_word[0]:
        begins = np.concatenate([[0], begins])
    ends = np.append(np.flatnonzero(characters == ord("\n")), len(text))
    return begins, np.diff(np.searchsorted(begins, ends), prepend=0)


def _sort_in_bulk(data: bytes) -> ObjStatements | None:
    """Group the lines of a file by keyword, with array operations.

    Returns None if the file needs the line-by-line parser.
    """
    characters = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(characters == ord("\n")) + 1
    starts = np.concatenate([[0], ends[:-1]])
    # Padding, so that the last line can be indexed like the others.
    padded = np.concatenate([characters, np.full(3, ord("\n"), np.uint8)])
    first, second, third = (padded[starts + at] for at in range(3))
    is_v, then_blank = first == ord("v"), _IS_BLANK[third]
    kinds = np.full(len(starts), -1, np.int8)
    kinds[is_v & _IS_BLANK[second]] = 0
    kinds[is_v & (second == ord("t")) & then_blank] = 1
    kinds[is_v & (second == ord("n")) & then_blank] = 2
    kinds[(first == ord("f")) & _IS_BLANK[second]] = _FACE_KIND
    if _IS_BLANK[first].any() or (
        b"#" in data and (kinds[_find_lines_with(characters, ends, "#")] >= 0).any()
    ):
        return None
    found = ObjStatements()
    texts = []
    for kind, key in enumerate(_KEYWORDS):
        chosen = kinds == kind
        text = _remove_keyword(_cut_out(data, starts, ends, chosen), key)
        words = find_words(text)[1]
        # A keyword without values has no effect and would break the count.
        if len(words) != np.count_nonzero(chosen) or not words.all():
            return None
        texts.append(text)
    found.positions, found.uvs, found.normals, found.faces = texts
    is_face = kinds == _FACE_KIND
    found.counts_before_face = np.stack(
        [np.cumsum(kinds == kind)[is_face] for kind in range(_FACE_KIND)], axis=1
    )
    faces = np.cumsum(is_face)
    for line in np.flatnonzero((kinds < 0) & (ends - starts > 1) & (first != ord("#"))).tolist():
        found.add(data[starts[line] : ends[line]].partition(b"#")[0], int(faces[line]))
    return found


def _find_lines_with(
    characters: NDArray[np.uint8], ends: NDArray[np.int64], character: str
) -> NDArray[np.int64]:
    """Return the indices of the lines that contain a character, once per occurrence."""
    return np.searchsorted(ends, np.flatnonzero(characters == ord(character)), side="right")


def _cut_out(
    data: bytes, starts: NDArray[np.int64], ends: NDArray[np.int64], chosen: NDArray[np.bool_]
) -> bytes:
    """Concatenate the chosen lines, copying runs of consecutive lines at once."""
    edges = np.flatnonzero(np.diff(chosen, prepend=False, append=False)).reshape(-1, 2)
    runs = zip(starts[edges[:, 0]].tolist(), ends[edges[:, 1] - 1].tolist(), strict=True)
    return b"".join([data[start:end] for start, end in runs])


def _remove_keyword(lines: bytes, key: bytes) -> bytes:
    text = b"\n" + lines.translate(_BLANKS)
    return text.replace(b"\n" + key + b" ", b"\n")[1:-1]


def _sort_line_by_line(data: bytes) -> ObjStatements:
    found = ObjStatements()
    rows: dict[bytes, list[bytes]] = {key: [] for key in _KEYWORDS}
    counts_before_face: list[tuple[int, ...]] = []
    for raw in data.splitlines():
        line = raw.partition(b"#")[0]
        words = line.split(None, 1)
        if len(words) == 2 and words[0] in rows:
            if words[0] == b"f":
                counts_before_face.append(tuple(len(rows[key]) for key in _KEYWORDS[:_FACE_KIND]))
            rows[words[0]].append(words[1].translate(_BLANKS))
        else:
            found.add(line, len(counts_before_face))
    found.positions, found.uvs, found.normals, found.faces = (b"\n".join(rows[key]) for key in _KEYWORDS)
    found.counts_before_face = np.array(counts_before_face, np.int64).reshape(-1, 3)
    return found
