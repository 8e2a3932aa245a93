"""Mesh files as arguments of commands: read, written, and named in what goes wrong with them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

import stages
from cli.output import Output
from cli.paths import require_file
from stages import Mesh, MeshError

MeshFile = Annotated[
    Path, typer.Argument(metavar="IN", help="Mesh file: PLY, OBJ, OFF, STL, glTF or GLB.", show_default=False)
]
NewMesh = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", help="Mesh file to write (.ply, .obj, .off, .stl, .glb).", show_default=False
    ),
]


def read_file(path: Path, out: Output) -> Mesh:
    """Return the mesh of a file; what its reader met on the way is remarked."""
    mesh = stages.read_mesh(require_file(path))
    for note in mesh.notes:
        out.remark(f"{path}: {note}")
    return mesh


@contextmanager
def about_file(path: Path) -> Iterator[None]:
    """Name the file in what a stage says about the mesh it was given."""
    try:
        yield
    except MeshError as error:
        if error.file != "mesh":
            raise
        raise MeshError(str(error).removeprefix("mesh: "), path) from error


def write_file(path: Path, mesh: Mesh, out: Output) -> None:
    """Write a mesh, into a folder that is made if need be, and remark how large it is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    stages.write_mesh(path, mesh)
    tell_written(path, mesh, out)


def tell_written(path: Path, mesh: Mesh, out: Output) -> None:
    """Remark how large a mesh is that was written."""
    out.remark(f"{path}: {len(mesh.vertices):,} vertices, {len(mesh.triangles):,} triangles")
