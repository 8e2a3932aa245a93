"""LAS and LAZ reader for laser scans and surveys.

Source: ASPRS, "LAS specification 1.4 - R15", 2019. Requires the optional packages `laspy` and `lazrs`; runs
in the subprocess of `cloud_process`. The header is validated before these packages see the file.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.input_files import open_input
from scanloom.stages.surface.codes import (
    MESH_CLOUD_DAMAGED,
    MESH_LEFT_OUT,
    MESH_POINTS_OUTSIDE,
    MESH_UNIT_NOT_METRES,
)
from scanloom.stages.surface.formats.cloud_chunks import CHUNK_POINTS, CloudChunkWriter

# Bytes of the shortest header, of the 1.4 header up to its 64-bit point count, and of a variable-length
# record's header.
_MIN_HEADER_BYTES, _HEADER_1_4_BYTES, _RECORD_HEADER_BYTES = 227, 255, 54
# Upper bits of the point format, which mark LAZ compression.
_COMPRESSED_BITS = 0xC0
# Extra dimensions that CloudCompare and other programs use for normals, in lower case.
_NORMAL_DIMENSIONS = (("normalx", "normaly", "normalz"), ("nx", "ny", "nz"))
# GeoTIFF keys: GTModelType (2 = geographic coordinates in degrees), ProjLinearUnits and VerticalUnits (9001 =
# metre).
_MODEL_TYPE_KEY, _UNIT_KEYS, _GEOGRAPHIC_MODEL, _METRE_CODE = 1024, (3076, 4099), 2, 9001


def read_las(path: Path, writer: CloudChunkWriter) -> None:
    """Read a file's points in chunks, with colours and normals.

    Raises
    ------
    InputError
        If the file is damaged or shorter than its header states. Other exceptions of laspy also mean damage;
        the caller handles them.
    """
    import laspy

    writer.check_point_count(_read_point_count(path))
    with laspy.open(open_input(path), laz_backend=laspy.LazBackend.Lazrs, read_evlrs=False) as reader:
        _report_unit(reader.header, path)
        names = {name.lower(): name for name in reader.header.point_format.dimension_names}
        withheld_count = outside_count = 0
        for chunk in reader.chunk_iterator(CHUNK_POINTS):
            keep = np.ones(len(chunk), bool)
            if "withheld" in names:
                keep = np.asarray(chunk[names["withheld"]]) == 0
            withheld_count += len(chunk) - int(np.count_nonzero(keep))
            points = np.stack([np.asarray(chunk[axis], np.float64) for axis in "xyz"], axis=1)
            outside_count += _count_points_outside(points, reader.header)
            columns = (_stack_dimensions(chunk, names, ("red", "green", "blue")), _read_normals(chunk, names))
            writer.append(points[keep], *(None if column is None else column[keep] for column in columns))
        if withheld_count:
            emit(
                MESH_LEFT_OUT.warning(
                    "{count:,} points are left out: they are marked as withheld", path, count=withheld_count
                )
            )
        if outside_count:
            emit(
                MESH_POINTS_OUTSIDE.warning(
                    "{count:,} points are outside the bounding box of the header: the file may be damaged",
                    path,
                    count=outside_count,
                )
            )


def _read_point_count(path: Path) -> int:
    """Return the header's point count, checked against the file size."""
    size = path.stat().st_size
    with open_input(path) as file:
        head = file.read(_HEADER_1_4_BYTES)
    if head[:4] != b"LASF":
        raise InputError(MESH_CLOUD_DAMAGED, "is not a LAS or LAZ file: it does not start with `LASF`.", path)
    if len(head) < _MIN_HEADER_BYTES:
        raise InputError(
            MESH_CLOUD_DAMAGED, "is cut short within its header", path, remedy="get a whole copy of it."
        )
    header_size, start, records, kind, length, points = struct.unpack_from("<HIIBHI", head, 94)
    if head[25] >= 4 and len(head) == _HEADER_1_4_BYTES:
        (points,) = struct.unpack_from("<Q", head, 247)
    held = max(size - start, 0) // max(length, 1)
    is_short = start > size or header_size + _RECORD_HEADER_BYTES * records > size
    if is_short or (not kind & _COMPRESSED_BITS and points > held):
        raise InputError(
            MESH_CLOUD_DAMAGED,
            "declares {points:,} points, more than it holds; it is damaged or cut short.",
            path,
            points=points,
        )
    return int(points)


def _count_points_outside(points: NDArray[np.float64], header: Any) -> int:
    """Count points outside the header's bounding box.

    Compressed points have no checksum, so outliers are the only sign of damage.
    """
    low, high = header.mins - 2 * header.scales, header.maxs + 2 * header.scales
    if not header.mins.any() and not header.maxs.any():
        return 0
    return int(np.count_nonzero(((points < low) | (points > high)).any(axis=1)))


def _stack_dimensions(part: Any, names: Mapping[str, str], wanted: tuple[str, ...]) -> NDArray[Any] | None:
    if not all(name in names for name in wanted):
        return None
    return np.stack([np.asarray(part[names[name]]) for name in wanted], axis=1)


def _read_normals(part: Any, names: Mapping[str, str]) -> NDArray[Any] | None:
    found = (_stack_dimensions(part, names, wanted) for wanted in _NORMAL_DIMENSIONS)
    return next((columns for columns in found if columns is not None), None)


def _report_unit(header: Any, path: Path) -> None:
    """Warn if the coordinates are not in metres."""

    def warn_unit(unit: str) -> None:
        emit(
            MESH_UNIT_NOT_METRES.warning(
                "its coordinates are in {unit} but used as metres: all lengths are in that unit",
                path,
                unit=unit,
            )
        )

    for record in header.vlrs:
        keys = {key.id: key.value_offset for key in getattr(record, "geo_keys", ())}
        if keys.get(_MODEL_TYPE_KEY) == _GEOGRAPHIC_MODEL:
            warn_unit("degrees")
        elif any(keys.get(key, _METRE_CODE) != _METRE_CODE for key in _UNIT_KEYS):
            warn_unit("a unit other than metres")
        text = str(getattr(record, "string", "")).upper()
        if text.startswith(("GEOGCS", "GEOGCRS")):
            warn_unit("degrees")
        elif "FOOT" in text or "FEET" in text:
            warn_unit("feet")
