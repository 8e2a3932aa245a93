"""E57 reader: merges the scans of a laser scanner with their poses.

Sources: ASTM E2807, "Standard specification for 3D imaging data exchange"; Huber, "The ASTM E57 file format
for 3D imaging data exchange", 2011. Requires the optional package `pye57`; runs in the subprocess of
`cloud_process`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.diagnostics.collector import emit
from scanloom.stages.diagnostics.errors import InputError
from scanloom.stages.files.input_files import open_input, require_regular_file
from scanloom.stages.surface.codes import MESH_CLOUD_DAMAGED, MESH_LEFT_OUT
from scanloom.stages.surface.formats.cloud_chunks import CHUNK_POINTS, CloudChunkWriter

_SIGNATURE = b"ASTM-E57"
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
# Non-zero for points without a valid distance or direction.
_INVALID_FLAGS = ("cartesianInvalidState", "sphericalInvalidState")
_MAX_COLOR = np.iinfo(np.uint16).max

Floats = NDArray[np.float64]


def read_e57(path: Path, writer: CloudChunkWriter) -> None:
    """Read the points of all scans in file coordinates, with colours and normals.

    Raises
    ------
    InputError
        If the file is not E57, has no coordinates, or ends early. Other exceptions of pye57 also mean damage;
        the caller handles them.
    """
    import pye57

    with open_input(path) as file:
        if file.read(len(_SIGNATURE)) != _SIGNATURE:
            raise InputError(
                MESH_CLOUD_DAMAGED, "is not an E57 file: it does not start with `ASTM-E57`.", path
            )
    file = pye57.E57(str(require_regular_file(path)))
    invalid = 0
    for number in range(file.scan_count):
        scan = file.get_header(number)
        writer.check_point_count(int(scan.point_count))
        invalid += _read_scan(file, scan, writer, path)
    if invalid:
        emit(
            MESH_LEFT_OUT.warning(
                "{count:,} points are left out: they are marked as invalid", path, count=invalid
            )
        )


def _read_scan(file: Any, scan: Any, writer: CloudChunkWriter, path: Path) -> int:
    """Append the points of one scan; return the number of invalid points dropped."""
    from pye57 import libe57

    fields = set(scan.point_fields)
    coordinate_fields = next((names for names in (_CARTESIAN, _SPHERICAL) if fields.issuperset(names)), None)
    if coordinate_fields is None:
        raise InputError(
            MESH_CLOUD_DAMAGED,
            "its points have no coordinates, only {fields}.",
            path,
            fields=", ".join(sorted(fields))[:200],
        )
    field_groups = [names for names in (coordinate_fields, _COLORS, _NORMALS) if fields.issuperset(names)]
    names = [name for group in field_groups for name in group] + [
        name for name in _INVALID_FLAGS if name in fields
    ]
    count = min(CHUNK_POINTS, max(int(scan.point_count), 1))
    columns = {name: np.empty(count) for name in names}
    buffers = libe57.VectorSourceDestBuffer()
    for name, column in columns.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, name, column, count, True, True))
    limits = _read_color_limits(scan) if _COLORS in field_groups else None
    rotation, translation = _read_pose(scan)
    reader = scan.points.reader(buffers)
    remaining_count, invalid_count = int(scan.point_count), 0
    while remaining_count > 0 and (read_count := int(reader.read())) > 0:
        remaining_count -= read_count
        is_valid = np.ones(read_count, bool)
        for name in set(_INVALID_FLAGS) & set(names):
            is_valid &= columns[name][:read_count] == 0
        invalid_count += read_count - int(np.count_nonzero(is_valid))
        groups = {
            group: np.stack([columns[name][:read_count][is_valid] for name in group], 1)
            for group in field_groups
        }
        points = (
            groups[coordinate_fields]
            if coordinate_fields is _CARTESIAN
            else _convert_from_spherical(groups[coordinate_fields])
        )
        writer.append(
            points @ rotation.T + translation,
            None if limits is None else _scale_colors(groups[_COLORS], *limits),
            groups[_NORMALS] @ rotation.T if _NORMALS in groups else None,
        )
    reader.close()
    if remaining_count > 0:
        raise InputError(
            MESH_CLOUD_DAMAGED,
            "ends {left:,} points before the declared count of {point_count:,}.",
            path,
            left=remaining_count,
            point_count=scan.point_count,
        )
    return invalid_count


def _read_pose(scan: Any) -> tuple[Floats, Floats]:
    """Return the rotation (3, 3) and translation (3,) of a scan.

    Values are read by field name. pye57's own accessor reads them in file order, which the format leaves
    open.
    """
    rotation, translation = np.eye(3), np.zeros(3)
    pose = scan["pose"] if "pose" in scan.scan_fields else None
    if pose is not None and pose.isDefined("rotation"):
        w, x, y, z = (pose["rotation"][name].value() for name in "wxyz")
        axis = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        rotation += (2 * w * axis + 2 * axis @ axis) / (w * w + x * x + y * y + z * z)
    if pose is not None and pose.isDefined("translation"):
        translation = np.array([pose["translation"][name].value() for name in "xyz"])
    return rotation, translation


def _convert_from_spherical(values: Floats) -> Floats:
    distance, azimuth, elevation = values.T
    level = distance * np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


def _read_color_limits(scan: Any) -> tuple[Floats, Floats]:
    """Return the minimum and maximum (3,) of each colour channel; default 0 and 255."""
    ends = np.array([[0.0] * 3, [255.0] * 3])
    if "colorLimits" in scan.scan_fields:
        limits = scan["colorLimits"]
        for row, end in enumerate(("Minimum", "Maximum")):
            for k, name in enumerate(_COLORS):
                if limits.isDefined(name + end):
                    ends[row, k] = limits[name + end].value()
    return ends[0], ends[1]


def _scale_colors(colors: Floats, low: Floats, high: Floats) -> NDArray[np.uint16]:
    shares = (colors - low) / np.where(high > low, high - low, 1.0)
    scaled: NDArray[np.uint16] = np.rint(np.nan_to_num(shares.clip(0, 1)) * _MAX_COLOR).astype(np.uint16)
    return scaled
