"""Textured source mesh of a hierarchy, embedded in its file.

Tiles and cuts get their texture from it. It is stored as a GLB file with the original images, so that it can
be extracted and opened.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

from scanloom.stages.files.input_files import read_input_bytes
from scanloom.stages.surface.formats.gltf import read_gltf
from scanloom.stages.surface.formats.gltf_writer import write_gltf
from scanloom.stages.surface.mesh import Mesh


def encode_glb(mesh: Mesh) -> bytes:
    """Encode a textured mesh as a GLB file.

    Vertices, triangles, texture coordinates, images and vertex colours are kept.

    Raises
    ------
    MeshError
        If a coordinate exceeds single precision.
    StageError
        If the file would exceed the GLB limit of 4 GiB, or the disk is full.
    """
    plain = Mesh(mesh.vertices, mesh.triangles, colors=mesh.colors, texture=mesh.texture, up=mesh.up)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.glb"
        write_gltf(path, plain)
        return read_input_bytes(path)


def decode_glb(data: bytes) -> Mesh:
    """Decode a mesh from the bytes of a GLB file.

    Raises
    ------
    InputError, MeshError
        If the bytes are not a valid GLB file.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.glb"
        path.write_bytes(data)
        return read_gltf(path)
