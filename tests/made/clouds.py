"""Point clouds, and their files in PLY, LAS, LAZ and E57."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scanloom.stages.surface.formats.ply import write_ply
from scanloom.stages.surface.mesh import Mesh

NO_TRIANGLES = np.zeros((0, 3), np.int32)


def make_cloud(points: Any, colors: Any = None, normals: Any = None) -> Mesh:
    return Mesh(np.asarray(points, np.float64), NO_TRIANGLES, colors, normals)


def write_cloud(path: Path, given: Mesh, offset: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> Path:
    """Write a cloud as PLY, LAS, LAZ or E57, chosen by the extension.

    LAS and LAZ round coordinates to 0.1 mm.
    """
    if path.suffix == ".ply":
        write_ply(path, given)
    elif path.suffix == ".e57":
        _write_e57(path, given, offset)
    else:
        make_las(given, offset).write(str(path))
    return path


def make_las(given: Mesh, offset: tuple[float, float, float] = (0.0, 0.0, 0.0), point_format: int = 7) -> Any:
    import laspy

    header = laspy.LasHeader(point_format=point_format)
    header.scales, header.offsets = np.full(3, 1e-4), np.array(offset)
    if given.normals is not None:
        header.add_extra_dims([laspy.ExtraBytesParams(f"Normal{axis}", "f4") for axis in "XYZ"])
    data = laspy.LasData(header)
    data.x, data.y, data.z = given.vertices.T
    if given.colors is not None:
        data.red, data.green, data.blue = given.colors.T.astype(np.uint16) * 257
    if given.normals is not None:
        for axis, values in zip("XYZ", given.normals.T, strict=True):
            data[f"Normal{axis}"] = values
    return data


def _write_e57(path: Path, given: Mesh, offset: tuple[float, float, float]) -> None:
    """Write a cloud as one E57 scan with a pose: rotated by 90° around z, then shifted."""
    import pye57

    x, y, z = (given.vertices - offset).T
    data = {"cartesianX": y, "cartesianY": -x, "cartesianZ": z}
    if given.colors is not None:
        data |= dict(zip(("colorRed", "colorGreen", "colorBlue"), given.colors.T, strict=True))
    half = np.sqrt(0.5)
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(data, rotation=np.array([half, 0, 0, half]), translation=np.array(offset))
