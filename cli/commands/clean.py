"""The command `clean`."""

from __future__ import annotations

import stages
from cli.mesh_arguments import MeshFile, NewMesh, about_file, read_file, tell_notes, write_file
from cli.output import Output
from cli.paths import MESH_SUFFIXES, require_new_file
from stages import CleanParams


def clean(source: MeshFile, target: NewMesh, params: CleanParams, out: Output) -> None:
    """Remove what a mesh should not have: islands, degenerate, duplicate and non-manifold parts.

    What comes out is an oriented manifold; colours survive. OUT may be IN: it is replaced in one step.

    Example: scanloom clean fused.ply clean.ply
    """
    require_new_file(target, MESH_SUFFIXES)
    mesh = read_file(source, out)
    with about_file(source):
        cleaned = stages.clean(mesh, params)
    tell_notes(source, cleaned.mesh.notes[len(mesh.notes) :], out)
    write_file(target, cleaned.mesh, out)
    out.result({"output": str(target), **cleaned.figures()})
