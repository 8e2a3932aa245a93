"""The textured mesh that levels were built of, as their file keeps it: tiles and cuts get images from it.

It is a GLB file within the file, with its images as they were, so that it can be taken out and opened.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from scanloom.stages.files.opening import content_of
from scanloom.stages.surface.formats.gltf import read_gltf
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh


def packed(mesh: Mesh) -> bytes:
    """Return a textured mesh as a GLB file: shape, texture coordinates, images and colours of vertices.

    Raises
    ------
    MeshError
        If a vertex lies beyond what single precision holds.
    StageError
        If it is larger than a GLB file can be (4 GiB), or there is no room for it on the disk.
    """
    plain = Mesh(mesh.vertices, mesh.triangles, colors=mesh.colors, texture=mesh.texture, up=mesh.up)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.glb"
        write_gltf(path, plain)
        return content_of(path)


def unpacked(data: bytes) -> Mesh:
    """Return the mesh of such bytes; raises InputError or MeshError where they are none."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.glb"
        path.write_bytes(data)
        return read_gltf(path)
