"""Meshes too large to be read at once: what of them other stages get to see."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from stages.errors import StageError
from stages.files.documents import read_json
from stages.simplification.methods import METHODS
from stages.surface.formats.ply import read_ply
from stages.surface.mesh import Mesh
from stages.surface.pieces import MOST_AT_ONCE, Pieces, table_of
from stages.surface.piecewise import Piecewise, piecewise

_PROOF = "proven.json"


def is_large(path: Path) -> bool:
    """Whether a mesh that a stage left in pieces has to be worked on piece by piece."""
    return table_of(path).exists()


def is_clean_large(read: Mapping[str, Any]) -> bool:
    """Whether of what a stage reads, as far as it is known, the clean mesh is one."""
    return "clean" in read and is_large(read["clean"] / "clean.ply")


def whole(path: Path, stage: str) -> Mesh:
    """Return a mesh for a stage that needs all of it.

    Raises
    ------
    StageError
        If it is too large for that.
    """
    if is_large(path):
        raise StageError(
            f"{stage} reads all of {path.name} at once, which has {Pieces(path).triangle_count:,} triangles; "
            f"it takes up to {MOST_AT_ONCE:,}. Give a larger fuse.voxel_size, or fuse a part (fuse.box)."
        )
    return read_ply(path)


def surface_of(path: Path) -> Mesh | Piecewise:
    """Return a mesh for a stage that takes it in pieces, too."""
    return Piecewise(Pieces(path)) if is_large(path) else read_ply(path)


def pieces_of(path: Path) -> Mesh | Piecewise:
    """Return a mesh for a stage that takes it in pieces wherever that saves memory."""
    return Piecewise(Pieces(path)) if is_large(path) else piecewise(read_ply(path))


@dataclass(frozen=True)
class Proof:
    """How far a mesh is from the large one that it was simplified from, at any point and both ways.

    Attributes
    ----------
    shape_bound_m : metres.
    color_bound_levels : None without colours.
    """

    shape_bound_m: float
    color_bound_levels: float | None


def write_proof(folder: Path, figures: Mapping[str, Any]) -> None:
    """Leave beside a simplified mesh what is proven of it, if its method proves anything."""
    proves = any(method.proves for method in METHODS if method.name == figures["method"])
    details = figures["details"]
    proven = {field.name: details[field.name] for field in fields(Proof)} if proves else None
    (folder / _PROOF).write_text(json.dumps(proven) + "\n", encoding="utf-8", newline="\n")


def read_proof(folder: Path) -> Proof | None:
    """Return what is proven of a simplified mesh; None for nothing."""
    if not (folder / _PROOF).is_file():
        return None
    proven: Any = read_json(folder / _PROOF)
    return None if proven is None else Proof(**proven)


def some_of(path: Path) -> Mesh:
    """Return a mesh, or of one that is too large as many of its triangles, evenly, as are not."""
    if not is_large(path):
        return read_ply(path)
    pieces = Pieces(path)
    step = -(-pieces.triangle_count // MOST_AT_ONCE)
    vertices, triangles, count = [], [], 0
    for number in range(len(pieces)):
        mesh = pieces.part(number).mesh
        used, place = np.unique(mesh.triangles[::step], return_inverse=True)
        vertices.append(mesh.vertices[used])
        triangles.append((place.reshape(-1, 3) + count).astype(np.int32))
        count += len(used)
    return Mesh(np.concatenate(vertices), np.concatenate(triangles))
