"""Diagnostic codes of levels of detail, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

LEVELS_FILE_DAMAGED = Code(
    "levels.file-damaged",
    "Damaged files of levels",
    """
The file is not a `.slod` or `.snm` file, or is damaged before its first level. Build it again from its mesh.
""",
    "clean.slod: the file is damaged or truncated before its first level.",
)
LEVELS_CUT_OFF = Code(
    "levels.cut-off",
    "Truncated files of levels",
    """
A truncated `.slod` file is still a coarser mesh: levels before the damage are read, with a warning. Tiles
require all levels, so writing them is an error. Copy the file again, or build it again from its mesh.
""",
    "clean.slod: the file ends after 12 of 85 nodes; finer levels are missing.",
)
LEVELS_BOUND_NOT_PROVEN = Code(
    "levels.bound-not-proven",
    "Triangles without a proof for the bound of their level",
    """
A warning. Each node states its proven bound, which is larger than the bound of its level here. Views and cuts
use the proven bound.
""",
    (
        "14 triangles are not proven to be within the bound of their level; their nodes state the larger "
        "bound that is proven."
    ),
)
LEVELS_MODEL_MISMATCH = Code(
    "levels.model-mismatch",
    "Model that does not match the levels",
    """
The model for `--texture` must have the same coordinates as the levels, and an image or vertex colours.
""",
    "model: has neither an image nor vertex colours for the tiles.",
)
LEVELS_TILES_TOO_FINE = Code(
    "levels.tiles-too-fine",
    "Levels too fine for tiles",
    """
Tiles store positions in single precision. A large and finely detailed model needs a coarser finest level
(`lod.base_error`).
""",
    (
        "vertices are too close to each other for tiles, which store positions in single precision; build "
        "the levels with a larger base_error."
    ),
)
LEVELS_LEFT_OUT = Code(
    "levels.left-out",
    "Attributes that levels drop",
    """
Warnings. Levels have no normals and parts. The textured mesh is stored at the end of the `.slod` file; if
that is lost, `--texture` restores the images of tiles. Images of tiles are opaque.
""",
    "lod drops these attributes of the mesh: parts, corner normals.",
)
LEVELS_ISLANDS_DROPPED = Code(
    "levels.islands-dropped",
    "Dropped small components",
    """
Small connected components are dropped only with `lod.drop_islands`. Error bounds then do not cover them. A
length that would drop the whole mesh is an error.
""",
    (
        "20 connected components smaller than 0.1 m, with 1,600 triangles, were dropped; error bounds do not "
        "cover them."
    ),
)
