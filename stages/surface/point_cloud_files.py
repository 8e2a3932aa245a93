"""Readers of point clouds: PLY without triangles, LAS, LAZ and E57.

LAS, LAZ and E57 need optional libraries. They are read in a separate process, because a damaged file can
crash these libraries.
"""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from pathlib import Path

from scanloom.stages.diagnostics.collector import collecting
from scanloom.stages.diagnostics.errors import InputError, UsageError
from scanloom.stages.files.codes import FILE_UNREADABLE
from scanloom.stages.files.input_files import describe_os_error, require_regular_file
from scanloom.stages.files.subprocess_reader import SubprocessDiedError, run_reader_subprocess
from scanloom.stages.surface.codes import (
    MACHINE_EXTRA_MISSING,
    MESH_CLOUD_DAMAGED,
    MESH_NO_SURFACE,
    USAGE_EXTENSION_UNKNOWN,
)
from scanloom.stages.surface.formats.cloud_chunks import assemble_cloud
from scanloom.stages.surface.formats.ply import read_ply
from scanloom.stages.surface.mesh import Mesh, validate_mesh
from scanloom.stages.surface.mesh_files import MESH_EXTENSIONS, read_mesh_or_empty

# Packages that each format requires.
_REQUIRED_PACKAGES = {".las": ("laspy",), ".laz": ("laspy", "lazrs"), ".e57": ("pye57",)}
CLOUD_EXTENSIONS = (".ply", *_REQUIRED_PACKAGES)
# CPU time limit of the reader process: a constant, plus seconds per byte (200 kB/s is slow).
_TIME_LIMIT_S, _TIME_LIMIT_S_PER_BYTE = 60.0, 5e-6


def read_cloud(path: Path | str) -> Mesh:
    """Read a point cloud file.

    The extension, one of CLOUD_EXTENSIONS, selects the format.

    Returns
    -------
    Mesh
        Points without triangles, with colours and normals if the file has them. Triangles of a PLY file are
        dropped. `up` is +z for LAS and LAZ, where z is the height, and for E57, whose scanners stand upright.

    Raises
    ------
    InputError
        If the file is missing, of another format, damaged, or holds no points.
    MeshError
        If a point is not finite.
    UsageError
        If the library that reads the format is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in CLOUD_EXTENSIONS:
        known = ", ".join(CLOUD_EXTENSIONS)
        raise InputError(
            USAGE_EXTENSION_UNKNOWN,
            "is not of a point cloud format: {path_suffix!r}; known are {known}.",
            path,
            path_suffix=path.suffix,
            known=known,
        )
    try:
        require_regular_file(path)
    except OSError as error:
        raise InputError(
            FILE_UNREADABLE, "cannot be read: {said_of}.", path, said_of=describe_os_error(error)
        ) from error
    if suffix == ".ply":
        mesh = read_ply(path)
        cloud = Mesh(
            mesh.vertices, mesh.triangles[:0], mesh.colors, mesh.normals, diagnostics=mesh.diagnostics
        )
    else:
        with collecting() as diagnostics:
            cloud = validate_mesh(_read_in_subprocess(path), str(path))
        cloud = cloud.with_(up=(0.0, 0.0, 1.0), diagnostics=tuple(diagnostics))
    if len(cloud.vertices) == 0:
        raise InputError(MESH_CLOUD_DAMAGED, "holds no points.", path)
    return cloud


def read_mesh_or_cloud(path: Path | str) -> Mesh:
    """Read a mesh file or a point cloud file; a cloud has no triangles.

    Raises
    ------
    InputError, UsageError
        As `read_mesh` and `read_cloud`, except that a file without triangles is accepted.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix in _REQUIRED_PACKAGES:
        return read_cloud(path)
    if suffix not in MESH_EXTENSIONS:
        known = ", ".join((*MESH_EXTENSIONS, *_REQUIRED_PACKAGES))
        raise InputError(
            USAGE_EXTENSION_UNKNOWN,
            "is of an unknown format {path_suffix!r}; known are {known}.",
            path,
            path_suffix=path.suffix,
            known=known,
        )
    mesh = read_mesh_or_empty(path)
    if len(mesh.vertices) == 0:
        raise InputError(MESH_NO_SURFACE, "holds no vertices.", path)
    return mesh


def _read_in_subprocess(path: Path) -> Mesh:
    suffix = path.suffix.lower()
    missing = [name for name in _REQUIRED_PACKAGES[suffix] if find_spec(name) is None]
    if missing:
        raise UsageError(
            MACHINE_EXTRA_MISSING,
            "reading {suffix} requires {missing}",
            remedy="install scanloom[clouds].",
            where=path,
            suffix=suffix,
            missing=" and ".join(missing),
        )
    time_limit_s = _TIME_LIMIT_S + _TIME_LIMIT_S_PER_BYTE * path.stat().st_size
    with tempfile.TemporaryDirectory(prefix="scanloom-") as folder:
        try:
            metadata = run_reader_subprocess(
                "scanloom.stages.surface.formats.cloud_process", [str(path), folder], time_limit_s
            )
        except SubprocessDiedError as error:
            raise InputError(
                MESH_CLOUD_DAMAGED,
                "cannot be read as {suffix}: it is damaged or cut short",
                path,
                remedy="get a whole copy.",
                suffix=suffix[1:].upper(),
            ) from error
        return assemble_cloud(Path(folder), metadata, path)
