"""PLY container: header and element tables.

Their meaning is interpreted elsewhere. Counts in the header are not trusted.

A file has text lines up to `end_header`, then rows of numbers, as text or binary in either byte order.
Source: Greg Turk, "The PLY polygon file format", 1994. An ASCII body is first converted to a binary body of
doubles, so one decoder handles both.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.input_files import open_input, read_input_bytes
from scanloom.stages.files.text_numbers import parse_numbers
from scanloom.stages.surface.codes import MESH_FILE_DAMAGED

# Bytes. Real headers take a few hundred; the limit avoids searching a huge non-PLY file for the header's end.
_MAX_HEADER_BYTES = 1 << 20
# Characters of a line of the header in a message.
_MAX_QUOTED = 80
_BYTE_ORDERS = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1",
    "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4",
    "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}  # fmt: skip
_DAMAGED = "the file is damaged or cut short"
_REMEDY = "get a whole copy of it."


@dataclass(frozen=True)
class PlyProperty:
    """A property declared by the header.

    Attributes
    ----------
    name : property name.
    dtype : type of the values.
    length_dtype : type of a list's length; None for a scalar.
    """

    name: str
    dtype: np.dtype[Any]
    length_dtype: np.dtype[Any] | None = None


@dataclass(frozen=True)
class PlyElement:
    """An element declared by the header: name, row count and properties."""

    name: str
    count: int
    properties: tuple[PlyProperty, ...]


@dataclass(frozen=True)
class PlyHeader:
    """A parsed PLY header; `size` is its length in bytes."""

    encoding: str
    elements: tuple[PlyElement, ...]
    comments: tuple[str, ...]
    size: int


@dataclass(frozen=True, eq=False)
class ListColumn:
    """A list property: `lengths` (rows,), and the concatenated values of all rows."""

    lengths: NDArray[np.int64]
    values: NDArray[Any]


PlyTable = dict[str, "NDArray[Any] | ListColumn"]


def read_tables(path: Path) -> tuple[PlyHeader, dict[str, PlyTable]]:
    """Read a PLY file's header and its elements, each as a dictionary of columns.

    Memory and time are proportional to the file size, not to the counts in the header.

    Raises
    ------
    InputError
        If the file cannot be opened, is not PLY, or is shorter than its header states.
    """
    try:
        data = read_input_bytes(path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {strerror}.", path, strerror=error.strerror
        ) from error
    try:
        header = parse_header(data)
        return header, _read_body(header, data)
    except _MalformedError as error:
        raise error.replace_location(path) from None


def read_row_count(path: Path, element: str) -> int:
    """Return an element's row count from the header of a PLY file; 0 if absent.

    Raises
    ------
    InputError
        If the file cannot be opened or is not PLY.
    """
    try:
        with open_input(path) as file:
            header = parse_header(file.read(_MAX_HEADER_BYTES))
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {strerror}.", path, strerror=error.strerror
        ) from error
    except _MalformedError as error:
        raise error.replace_location(path) from None
    return sum(one.count for one in header.elements if one.name == element)


@dataclass(frozen=True)
class BinaryRows:
    """Location of a table with fixed-size rows in a binary file.

    Attributes
    ----------
    path : the file.
    dtype : structured type of a row.
    offset : offset of the first row in bytes from the start of the file.
    count : number of rows.
    """

    path: Path
    dtype: np.dtype[Any]
    offset: int
    count: int

    def read_chunks(self, chunk_size: int) -> Iterator[NDArray[Any]]:
        """Yield the rows in chunks of `chunk_size`.

        Raises
        ------
        InputError
            If the file is truncated.
        """
        for first in range(0, self.count, chunk_size):
            count = min(chunk_size, self.count - first)
            with open_input(self.path) as file:
                file.seek(self.offset + first * self.dtype.itemsize)
                rows = np.frombuffer(file.read(count * self.dtype.itemsize), self.dtype)
            if len(rows) != count:
                raise InputError(MESH_FILE_DAMAGED, _DAMAGED, self.path, remedy=_REMEDY)
            yield rows


# Fields of a face row: corner count and vertex indices.
LENGTH_FIELD, CORNERS_FIELD = "length", "corners"


def locate_triangle_rows(path: Path) -> tuple[BinaryRows, BinaryRows]:
    """Locate the vertex and face rows in a binary file, for reading in chunks.

    The file must contain exactly the elements `vertex` and `face`, in this order. Face rows have the fields
    LENGTH and CORNERS. The caller must check that LENGTH is 3 in every row, else CORNERS is meaningless.

    Raises
    ------
    InputError
        If the file cannot be opened, has other elements, or its size contradicts the header.
    """
    try:
        with open_input(path) as file:
            header = parse_header(file.read(_MAX_HEADER_BYTES))
        size = path.stat().st_size
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {strerror}.", path, strerror=error.strerror
        ) from error
    except _MalformedError as error:
        raise error.replace_location(path) from None
    match header.elements:
        case [
            PlyElement("vertex", vertices, columns),
            PlyElement("face", faces, [PlyProperty() as corners]),
        ] if (
            header.encoding != "ascii"
            and corners.length_dtype is not None
            and all(column.length_dtype is None for column in columns)
            and {"x", "y", "z"} <= {column.name for column in columns}
        ):
            row = np.dtype([(column.name, column.dtype) for column in columns])
            face = np.dtype([(LENGTH_FIELD, corners.length_dtype), (CORNERS_FIELD, corners.dtype, (3,))])
        case _:
            raise InputError(
                MESH_FILE_DAMAGED, "it is not a binary file of vertices and triangles alone.", path
            )
    end = header.size + vertices * row.itemsize
    if size != end + faces * face.itemsize:
        raise InputError(
            MESH_FILE_DAMAGED,
            "it is not as long as its header promises of triangles; {damaged}",
            path,
            remedy=_REMEDY,
            damaged=_DAMAGED,
        )
    return BinaryRows(path, row, header.size, vertices), BinaryRows(path, face, end, faces)


class _MalformedError(InputError):
    """Error in the content of a file, raised before the path is known."""


def parse_header(data: bytes) -> PlyHeader:
    """Parse the header up to `end_header`; common variants of line ends are accepted."""
    start = data[:_MAX_HEADER_BYTES]
    if not re.match(rb"ply[ \t]*[\r\n]", start):
        raise _MalformedError(MESH_FILE_DAMAGED, "is not a PLY file: it does not start with a line `ply`.")
    # The first line decides the line ending, because a binary body can start with a line-feed byte. Some
    # programs mix \n and \r\n.
    line_end = rb"\r?\n" if re.match(rb"[^\r\n]*\r?\n", start) else rb"\r"
    end = re.search(rb"[\r\n]end_header[ \t]*" + line_end, start)
    if end is None:
        raise _MalformedError(
            MESH_FILE_DAMAGED,
            "its header has no line `end_header`; {damaged}",
            remedy=_REMEDY,
            damaged=_DAMAGED,
        )
    lines = re.split(r"\r?\n|\r", start[: end.start()].decode("latin-1"))

    encoding = ""
    comments: list[str] = []
    elements: list[tuple[str, int, list[PlyProperty]]] = []
    for line in lines[1:]:
        match line.split():
            case ["format", str(encoding), _]:
                pass
            case ["comment" | "obj_info", *_]:
                comments.append(line.split(maxsplit=1)[-1].strip())
            case ["element", name, count]:
                elements.append((name, _parse_count(line, count), []))
            case ["property", *words] if elements:
                elements[-1][2].append(_parse_property(line, words, encoding))
            case []:
                pass
            case _:
                raise _describe_unknown_line(line)
    if encoding not in _BYTE_ORDERS:
        raise _MalformedError(
            MESH_FILE_DAMAGED,
            "its format is {encoding!r}; {known} are known.",
            encoding=encoding,
            known=", ".join(_BYTE_ORDERS),
        )
    return PlyHeader(
        encoding,
        tuple(PlyElement(name, count, tuple(properties)) for name, count, properties in elements),
        tuple(comments),
        end.end(),
    )


def _parse_count(line: str, word: str) -> int:
    if not re.fullmatch(r"[0-9]{1,18}", word):
        raise _MalformedError(
            MESH_FILE_DAMAGED, "its header line {line!r} has no usable count.", line=line[:_MAX_QUOTED]
        )
    return int(word)


def _parse_property(line: str, words: list[str], encoding: str) -> PlyProperty:
    order = _BYTE_ORDERS.get(encoding, "=")
    match words:
        case [kind, name] if kind in _TYPES:
            return PlyProperty(name, np.dtype(order + _TYPES[kind]))
        case ["list", length, kind, name] if length in _TYPES and kind in _TYPES:
            return PlyProperty(name, np.dtype(order + _TYPES[kind]), np.dtype(order + _TYPES[length]))
    raise _describe_unknown_line(line)


def _describe_unknown_line(line: str) -> _MalformedError:
    return _MalformedError(
        MESH_FILE_DAMAGED,
        "its header has the line {line!r}, which is not understood.",
        line=line[:_MAX_QUOTED],
    )


def _read_body(header: PlyHeader, data: bytes) -> dict[str, PlyTable]:
    _require_size(header, len(data) - header.size)
    if header.encoding == "ascii":
        body, at = memoryview(_parse_ascii_numbers(data[header.size :]).tobytes()), 0
    else:
        body, at = memoryview(data), header.size
    tables: dict[str, PlyTable] = {}
    for element in header.elements:
        columns, at = _decode(_make_stored_element(element, header.encoding), body, at)
        table = tables.setdefault(element.name, {})
        for declared, column in zip(element.properties, columns, strict=True):
            table.setdefault(declared.name, _cast_column(column, declared, element.name))
    return tables


def _parse_ascii_numbers(text: bytes) -> NDArray[np.float64]:
    try:
        return parse_numbers(text)
    except ValueError as error:
        raise _MalformedError(MESH_FILE_DAMAGED, "{reason}", reason=str(error)) from None


def _make_stored_element(element: PlyElement, encoding: str) -> PlyElement:
    if encoding != "ascii":
        return element
    double = np.dtype(np.float64)
    columns = tuple(PlyProperty(p.name, double, p.length_dtype and double) for p in element.properties)
    return PlyElement(element.name, element.count, columns)


def _require_size(header: PlyHeader, size: int) -> None:
    """Refuse a body shorter than the minimum size that the header implies."""
    needed = 0
    for element in header.elements:
        if header.encoding == "ascii":
            needed += element.count * 2 * len(element.properties)  # a digit and a separator
        else:
            needed += element.count * sum((p.length_dtype or p.dtype).itemsize for p in element.properties)
    if needed > size + 1:
        promised = ", ".join(f"{e.count:,} × {e.name}" for e in header.elements)
        raise _MalformedError(
            MESH_FILE_DAMAGED,
            "its header promises {promised}, at least {needed:,} bytes, but only {size:,} follow; {damaged}",
            remedy=_REMEDY,
            damaged=_DAMAGED,
            promised=promised,
            needed=needed,
            size=size,
        )


def _decode(element: PlyElement, body: memoryview, at: int) -> tuple[list[NDArray[Any] | ListColumn], int]:
    """Decode an element; return its columns and the offset after its last row."""
    rows = _decode_equal_rows(element, body, at)
    return rows if rows is not None else _decode_ragged_rows(element, body, at)


def _decode_equal_rows(
    element: PlyElement, body: memoryview, at: int
) -> tuple[list[NDArray[Any] | ListColumn], int] | None:
    """Decode rows of equal size without a loop; None if list lengths differ between rows."""
    if element.count == 0:
        nothing = [np.empty(0, column.dtype) for column in element.properties]
        return [
            values if column.length_dtype is None else ListColumn(np.empty(0, np.int64), values)
            for column, values in zip(element.properties, nothing, strict=True)
        ], at
    lengths = []
    offset = at
    for column in element.properties:
        if column.length_dtype is None:
            offset += column.dtype.itemsize
            continue
        lengths.append(_read_length(element, column.length_dtype, body, offset))
        offset += column.length_dtype.itemsize + lengths[-1] * column.dtype.itemsize
    stride = offset - at
    end = at + element.count * stride
    if end > len(body):
        if lengths:
            return None
        raise _MalformedError(
            MESH_FILE_DAMAGED,
            "it ends after {row_count:,} of {promised_count:,} {element} entries; {damaged}",
            remedy=_REMEDY,
            row_count=(len(body) - at) // stride,
            promised_count=element.count,
            element=element.name,
            damaged=_DAMAGED,
        )

    decoded: list[NDArray[Any] | ListColumn] = []
    remaining = iter(lengths)
    for column in element.properties:
        if column.length_dtype is None:
            decoded.append(np.ndarray(element.count, column.dtype, body, at, stride))
            at += column.dtype.itemsize
            continue
        length = next(remaining)
        stored = np.ndarray(element.count, column.length_dtype, body, at, stride)
        if not (stored == length).all():
            return None
        at += column.length_dtype.itemsize
        size = column.dtype.itemsize
        values = np.ndarray((element.count, length), column.dtype, body, at, (stride, size))
        decoded.append(ListColumn(np.full(element.count, length, np.int64), values.reshape(-1)))
        at += length * size
    return decoded, end


def _decode_ragged_rows(
    element: PlyElement, body: memoryview, at: int
) -> tuple[list[NDArray[Any] | ListColumn], int]:
    """Decode rows of different sizes.

    A loop finds the offset of each list; the columns are then gathered at these offsets.
    """
    # Per list property: bytes of scalars before it, type of its length, and size of a value.
    steps = []
    skip = 0
    for column in element.properties:
        if column.length_dtype is None:
            skip += column.dtype.itemsize
        else:
            steps.append((skip, struct.Struct(_get_struct_code(column.length_dtype)), column.dtype.itemsize))
            skip = 0
    starts: list[list[int]] = [[] for _ in steps]  # offset of each list's first value
    lengths: list[list[int]] = [[] for _ in steps]
    row_starts = []
    limit = len(body)
    for row in range(element.count):
        row_starts.append(at)
        for index, (before, stored, size) in enumerate(steps):
            at += before + stored.size
            if at > limit:
                raise _describe_end(element, row)
            (length,) = stored.unpack_from(body, at - stored.size)
            if not length >= 0 or length % 1:
                raise _describe_length(element, row, length)
            starts[index].append(at)
            lengths[index].append(int(length))
            at += int(length) * size
        at += skip
        if at > limit:
            raise _describe_end(element, row)

    decoded: list[NDArray[Any] | ListColumn] = []
    offsets = np.array(row_starts, np.int64)
    step = 0
    for column in element.properties:
        if column.length_dtype is None:
            decoded.append(_gather_values(body, column.dtype, offsets))
            offsets = offsets + column.dtype.itemsize
            continue
        counts = np.array(lengths[step], np.int64)
        first = np.array(starts[step], np.int64)
        position = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
        where = np.repeat(first, counts) + position * column.dtype.itemsize
        decoded.append(ListColumn(counts, _gather_values(body, column.dtype, where)))
        offsets = first + counts * column.dtype.itemsize
        step += 1
    return decoded, at


def _gather_values(body: memoryview, dtype: np.dtype[Any], offsets: NDArray[np.int64]) -> NDArray[Any]:
    if len(offsets) == 0:
        return np.empty(0, dtype)
    # A strided view with one value per byte lets NumPy gather unaligned values.
    windows = np.ndarray(len(body) - dtype.itemsize + 1, dtype, body, 0, 1)
    return np.asarray(windows[offsets])


def _read_length(element: PlyElement, dtype: np.dtype[Any], body: memoryview, at: int) -> int:
    if at + dtype.itemsize > len(body):
        raise _describe_end(element, 0)
    length = np.ndarray(1, dtype, body, at)[0].item()
    if not length >= 0 or length % 1:
        raise _describe_length(element, 0, length)
    return int(length)


def _get_struct_code(dtype: np.dtype[Any]) -> str:
    order = dtype.byteorder if dtype.byteorder in "<>" else "="
    return order + dtype.char.replace("l", "i").replace("L", "I")


def _describe_end(element: PlyElement, row: int) -> _MalformedError:
    return _MalformedError(
        MESH_FILE_DAMAGED,
        "it ends within {element} {row:,} of {promised_count:,}; {damaged}",
        remedy=_REMEDY,
        element=element.name,
        row=row,
        promised_count=element.count,
        damaged=_DAMAGED,
    )


def _describe_length(element: PlyElement, row: int, length: Any) -> _MalformedError:
    return _MalformedError(
        MESH_FILE_DAMAGED,
        "{element} {row:,} holds a list of length {length:g}; {damaged}",
        remedy=_REMEDY,
        element=element.name,
        row=row,
        length=length,
        damaged=_DAMAGED,
    )


def _cast_column(
    column: NDArray[Any] | ListColumn, declared: PlyProperty, element: str
) -> NDArray[Any] | ListColumn:
    """Cast a column that was read from text to its declared type."""
    if isinstance(column, ListColumn):
        return ListColumn(column.lengths, _cast_values(column.values, declared, element))
    return _cast_values(column, declared, element)


def _cast_values(values: NDArray[Any], declared: PlyProperty, element: str) -> NDArray[Any]:
    if values.dtype == declared.dtype or declared.dtype.kind == "f":
        return values
    limits = np.iinfo(declared.dtype)
    fits = (values >= limits.min) & (values <= limits.max) & (values == np.floor(values))
    if not fits.all():
        raise _MalformedError(
            MESH_FILE_DAMAGED,
            "{property} of a {element} is {value:g}; the header declares whole numbers from {low} to {high}.",
            property=declared.name,
            element=element,
            value=float(values[np.flatnonzero(~fits)[0]]),
            low=limits.min,
            high=limits.max,
        )
    return values.astype(declared.dtype)
