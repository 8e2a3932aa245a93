"""Mesh files as arguments of commands: read, written, and named in what goes wrong with them."""

from __future__ import annotations

import re
from collections.abc import Container, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

import stages
from cli.output import Output
from cli.paths import require_file
from stages import Mesh, MeshError
from stages.diagnostics.diagnostic import Where
from stages.surface.cloud import is_cloud
from stages.surface.cloud_files import read_mesh_or_cloud
from stages.surface.mesh_files import lost_with, standing

# The one note of a reader that nothing is lost by: a surface of polygons is as good as one of triangles.
_HARMLESS = re.compile(r"[\d,]+ polygons? (was|were) split into triangles")

MeshFile = Annotated[
    Path, typer.Argument(metavar="IN", help="Mesh file: PLY, OBJ, OFF, STL, glTF or GLB.", show_default=False)
]
NewMesh = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", help="Mesh file to write (.ply, .obj, .off, .stl, .glb).", show_default=False
    ),
]


def read_file(path: Path, out: Output, *, used: Container[str] = ()) -> Mesh:
    """Return the mesh of a file; what its reader changed or could not use is told, but for notes `used`."""
    mesh = stages.read_mesh(require_file(path))
    tell_notes(path, [note for note in mesh.notes if note not in used], out)
    return mesh


def read_file_or_cloud(path: Path, out: Output) -> Mesh:
    """Return the mesh of a file, or its cloud, which has no triangles, and remark that it is one."""
    mesh = read_mesh_or_cloud(require_file(path))
    tell_notes(path, mesh.notes, out)
    if is_cloud(mesh):
        out.remark(f"{path}: no triangles; it is taken as a cloud of {len(mesh.vertices):,} points.")
    return mesh


def read_standing(path: Path, out: Output) -> Mesh:
    """Return the same, and what is up in it: y in a glTF file that says nothing else, by its format."""
    return standing(path, read_file(path, out))


def tell_notes(path: Path, notes: Iterable[str], out: Output) -> None:
    """Warn of what a mesh lost on the way; that it consists of triangles now is only remarked."""
    for note in notes:
        tell = out.remark if _HARMLESS.fullmatch(note) else out.warn
        tell(f"{path}: {note}")


@contextmanager
def about_file(path: Path, called: str = "mesh") -> Iterator[None]:
    """Name the file in what a stage says about the mesh it was given, and `called` so."""
    try:
        yield
    except MeshError as error:
        if error.diagnostic.where != Where(called):
            raise
        raise error.at(path) from error


def write_file(path: Path, mesh: Mesh, out: Output, original: Mesh | None = None) -> None:
    """Write a mesh, into a folder that is made if need be, and remark how large it is.

    Parameters
    ----------
    original : mesh whose colours are missed where the format holds none; `mesh` by default.
    """
    if lost := lost_with(path.suffix.lower(), mesh if original is None else original):
        out.warn(f"{path}: {path.suffix} holds the shape alone: the {lost} are left out; write .ply or .glb.")
    path.parent.mkdir(parents=True, exist_ok=True)
    stages.write_mesh(path, mesh)
    tell_written(path, mesh, out)


def tell_written(path: Path, mesh: Mesh, out: Output) -> None:
    """Remark how large a mesh is that was written."""
    if is_cloud(mesh):
        out.remark(f"{path}: {len(mesh.vertices):,} points")
    else:
        out.remark(f"{path}: {len(mesh.vertices):,} vertices, {len(mesh.triangles):,} triangles")
