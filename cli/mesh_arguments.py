"""Mesh files as arguments of commands."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from scanloom import stages
from scanloom.cli.output import Output
from scanloom.cli.paths import require_file
from scanloom.stages import Mesh, MeshError
from scanloom.stages.diagnostics.collector import emit, transform_diagnostics
from scanloom.stages.diagnostics.diagnostic import Diagnostic, DiagnosticLocation
from scanloom.stages.surface.codes import MESH_LEFT_OUT
from scanloom.stages.surface.mesh_files import list_unsupported_data, set_default_up
from scanloom.stages.surface.point_cloud import is_cloud
from scanloom.stages.surface.point_cloud_files import read_mesh_or_cloud

MeshFile = Annotated[
    Path, typer.Argument(metavar="IN", help="Mesh file: PLY, OBJ, OFF, STL, glTF or GLB.", show_default=False)
]
NewMesh = Annotated[
    Path,
    typer.Argument(
        metavar="OUT", help="Mesh file to write (.ply, .obj, .off, .stl, .glb).", show_default=False
    ),
]


def read_mesh_file(path: Path) -> Mesh:
    """Read the mesh of a file."""
    return stages.read_mesh(require_file(path))


def read_mesh_or_cloud_file(path: Path, out: Output) -> Mesh:
    """Read a mesh or point cloud, and print a remark for a cloud."""
    mesh = read_mesh_or_cloud(require_file(path))
    if is_cloud(mesh):
        out.remark(f"{path}: no triangles; treated as a point cloud of {len(mesh.vertices):,} points.")
    return mesh


def read_with_up(path: Path) -> Mesh:
    """Read a mesh with its up direction; glTF files are y-up unless they state another."""
    return set_default_up(path, read_mesh_file(path))


@contextmanager
def locate_diagnostics(path: Path, called: str = "mesh") -> Iterator[None]:
    """Name the file in diagnostics about its mesh, which otherwise name `called` as the location."""

    def locate(diagnostic: Diagnostic) -> Diagnostic:
        is_about_mesh = diagnostic.where is None or diagnostic.where == DiagnosticLocation(called)
        return diagnostic.replace_location(path) if is_about_mesh else diagnostic

    try:
        with transform_diagnostics(locate):
            yield
    except MeshError as error:
        if error.diagnostic.where != DiagnosticLocation(called):
            raise
        raise error.replace_location(path) from error


def write_mesh_file(path: Path, mesh: Mesh, out: Output, original: Mesh | None = None) -> None:
    """Write a mesh and print its size; the folder is created if missing.

    Parameters
    ----------
    original : mesh whose colours are reported as lost if the format holds none; `mesh` by default.
    """
    if lost := list_unsupported_data(path.suffix.lower(), mesh if original is None else original):
        emit(
            MESH_LEFT_OUT.warning(
                "{format} stores geometry only: the {lost} are left out",
                path,
                remedy="write .ply or .glb.",
                format=path.suffix,
                lost=lost,
            )
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    stages.write_mesh(path, mesh)
    remark_written(path, mesh, out)


def remark_written(path: Path, mesh: Mesh, out: Output) -> None:
    """Print the size of a written mesh."""
    if is_cloud(mesh):
        out.remark(f"{path}: {len(mesh.vertices):,} points")
    else:
        out.remark(f"{path}: {len(mesh.vertices):,} vertices, {len(mesh.triangles):,} triangles")
