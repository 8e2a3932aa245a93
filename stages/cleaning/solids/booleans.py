"""Boolean operations of closed meshes with `manifold3d`, which keep the source of each triangle."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanloom.stages.cleaning.solids.shell import Shell
from scanloom.stages.diagnostics.errors import UsageError
from scanloom.stages.surface.codes import MACHINE_EXTRA_MISSING
from scanloom.stages.surface.edges import Ids

# Rounding of the base of an object, as a ratio of its size.
_TRIM_TOLERANCE = 1e-9
# First face id of triangles without a source; the library stores face ids in 32 bits.
_NO_SOURCE = 2**30


def require_manifold3d() -> Any:
    """Return the module `manifold3d`.

    Raises
    ------
    UsageError
        If `manifold3d` is not installed; the message names the package to install.
    """
    try:
        import manifold3d
    except ImportError:
        raise UsageError(
            MACHINE_EXTRA_MISSING, "making solids requires manifold3d", remedy="install scanloom[solid]."
        ) from None
    return manifold3d


def to_manifold(shell: Shell) -> Any:
    """Convert a closed oriented manifold to `manifold3d.Manifold`; its status tells if it is one."""
    library = require_manifold3d()
    # The library merges coplanar triangles with equal face ids.
    own = np.where(shell.source < 0, _NO_SOURCE + np.arange(len(shell.source)), shell.source)
    return library.Manifold(
        library.Mesh64(
            vert_properties=np.ascontiguousarray(shell.vertices),
            tri_verts=np.ascontiguousarray(shell.triangles, np.uint64),
            run_original_id=np.array([library.Manifold.reserve_ids(1)], np.uint32),
            face_id=own.astype(np.uint64),
        )
    )


def trim_by_plane(shell: Shell, normal: NDArray[np.float64], offset: float) -> Shell:
    """Cut off what is below the plane of the points x with normal · x = offset."""
    if not len(shell.vertices):
        return shell
    tolerance = _TRIM_TOLERANCE * float(np.ptp(shell.vertices))
    if float((shell.vertices @ normal).min()) >= offset - tolerance:
        return shell
    trimmed = from_manifold(to_manifold(shell).trim_by_plane(normal.tolist(), offset))
    # The library gives the cut the id of some triangle.
    is_cut = (trimmed.vertices @ normal)[trimmed.triangles].max(axis=1) <= offset + tolerance
    return Shell(trimmed.vertices, trimmed.triangles, np.where(is_cut, -1, trimmed.source))


def from_manifold(manifold: Any) -> Shell:
    """Convert the result of Boolean operations, in an order that depends only on the surface."""
    mesh = manifold.to_mesh64()
    vertices = np.asarray(mesh.vert_properties, np.float64)[:, :3]
    triangles = np.asarray(mesh.tri_verts).astype(np.int64)
    face_ids = np.asarray(mesh.face_id).astype(np.int64)
    source = np.where(face_ids >= _NO_SOURCE, -1, face_ids)
    order = np.lexsort(vertices.T)
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    rotated = _rotate_to_smallest(number[triangles])
    rows = np.lexsort((*rotated.T[::-1], source))
    return Shell(vertices[order], rotated[rows].astype(np.int32), source[rows])


def _rotate_to_smallest(triangles: Ids) -> Ids:
    """Rotate the corners of triangles so that the smallest index is first."""
    shift = triangles.argmin(axis=1)[:, None] + np.arange(3)
    return np.take_along_axis(triangles, shift % 3, axis=1)
