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
from scanloom.stages.files.opening import opened, require_regular
from scanloom.stages.surface.codes import MESH_CLOUD_DAMAGED, MESH_LEFT_OUT
from scanloom.stages.surface.formats.cloud_parts import PART, Parts

_START = b"ASTM-E57"
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_COLORS = ("colorRed", "colorGreen", "colorBlue")
_NORMALS = ("nor:normalX", "nor:normalY", "nor:normalZ")
# Non-zero for points without a valid distance or direction.
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
_BRIGHTEST = np.iinfo(np.uint16).max

Floats = NDArray[np.float64]


def read_e57(path: Path, parts: Parts) -> None:
    """Read the points of all scans in file coordinates, with colours and normals.

    Raises
    ------
    InputError
        If the file is not E57, has no coordinates, or ends early. Other exceptions of pye57 also mean damage;
        the caller handles them.
    """
    import pye57

    with opened(path) as file:
        if file.read(len(_START)) != _START:
            raise InputError(
                MESH_CLOUD_DAMAGED, "is not an E57 file: it does not start with `ASTM-E57`.", path
            )
    file = pye57.E57(str(require_regular(path)))
    invalid = 0
    for number in range(file.scan_count):
        scan = file.get_header(number)
        parts.promise(int(scan.point_count))
        invalid += _read_scan(file, scan, parts, path)
    if invalid:
        emit(
            MESH_LEFT_OUT.warning(
                "{count:,} points are left out: they are marked as invalid", path, count=invalid
            )
        )


def _read_scan(file: Any, scan: Any, parts: Parts, path: Path) -> int:
    """Append the points of one scan; return the number of invalid points dropped."""
    from pye57 import libe57

    fields = set(scan.point_fields)
    places = next((names for names in (_CARTESIAN, _SPHERICAL) if fields.issuperset(names)), None)
    if places is None:
        raise InputError(
            MESH_CLOUD_DAMAGED,
            "its points have no coordinates, only {fields}.",
            path,
            fields=", ".join(sorted(fields))[:200],
        )
    wanted = [names for names in (places, _COLORS, _NORMALS) if fields.issuperset(names)]
    names = [name for group in wanted for name in group] + [name for name in _INVALID if name in fields]
    count = min(PART, max(int(scan.point_count), 1))
    columns = {name: np.empty(count) for name in names}
    buffers = libe57.VectorSourceDestBuffer()
    for name, column in columns.items():
        buffers.append(libe57.SourceDestBuffer(file.image_file, name, column, count, True, True))
    limits = _color_limits(scan) if _COLORS in wanted else None
    turn, shift = _pose(scan)
    reader = scan.points.reader(buffers)
    left, invalid = int(scan.point_count), 0
    while left > 0 and (held := int(reader.read())) > 0:
        left -= held
        is_valid = np.ones(held, bool)
        for name in set(_INVALID) & set(names):
            is_valid &= columns[name][:held] == 0
        invalid += held - int(np.count_nonzero(is_valid))
        groups = {group: np.stack([columns[name][:held][is_valid] for name in group], 1) for group in wanted}
        points = groups[places] if places is _CARTESIAN else _from_spherical(groups[places])
        parts.append(
            points @ turn.T + shift,
            None if limits is None else _scaled(groups[_COLORS], *limits),
            groups[_NORMALS] @ turn.T if _NORMALS in groups else None,
        )
    reader.close()
    if left > 0:
        raise InputError(
            MESH_CLOUD_DAMAGED,
            "ends {left:,} points before the declared count of {point_count:,}.",
            path,
            left=left,
            point_count=scan.point_count,
        )
    return invalid


def _pose(scan: Any) -> tuple[Floats, Floats]:
    """Return the rotation (3, 3) and translation (3,) of a scan.

    Values are read by field name. pye57's own accessor reads them in file order, which the format leaves
    open.
    """
    turn, shift = np.eye(3), np.zeros(3)
    pose = scan["pose"] if "pose" in scan.scan_fields else None
    if pose is not None and pose.isDefined("rotation"):
        w, x, y, z = (pose["rotation"][name].value() for name in "wxyz")
        axis = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turn += (2 * w * axis + 2 * axis @ axis) / (w * w + x * x + y * y + z * z)
    if pose is not None and pose.isDefined("translation"):
        shift = np.array([pose["translation"][name].value() for name in "xyz"])
    return turn, shift


def _from_spherical(values: Floats) -> Floats:
    distance, azimuth, elevation = values.T
    level = distance * np.cos(elevation)
    return np.stack([level * np.cos(azimuth), level * np.sin(azimuth), distance * np.sin(elevation)], axis=1)


def _color_limits(scan: Any) -> tuple[Floats, Floats]:
    """Return the minimum and maximum (3,) of each colour channel; default 0 and 255."""
    ends = np.array([[0.0] * 3, [255.0] * 3])
    if "colorLimits" in scan.scan_fields:
        limits = scan["colorLimits"]
        for row, end in enumerate(("Minimum", "Maximum")):
            for k, name in enumerate(_COLORS):
                if limits.isDefined(name + end):
                    ends[row, k] = limits[name + end].value()
    return ends[0], ends[1]


def _scaled(colors: Floats, low: Floats, high: Floats) -> NDArray[np.uint16]:
    shares = (colors - low) / np.where(high > low, high - low, 1.0)
    scaled: NDArray[np.uint16] = np.rint(np.nan_to_num(shares.clip(0, 1)) * _BRIGHTEST).astype(np.uint16)
    return scaled
