"""Diagnostic codes of levels of detail, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

LEVELS_FILE_DAMAGED = Code(
    "levels.file-damaged",
    "Files of levels that are damaged",
    """
The file is no `.slod` or `.snm` file, or is damaged before its first level. Make it again from its mesh.
""",
    "clean.slod: the file is damaged or cut off before its first level.",
)
LEVELS_CUT_OFF = Code(
    "levels.cut-off",
    "Files of levels that end early",
    """
A `.slod` file that ends early is a coarser mesh: levels before the damage are read, with a warning. Tiles
need all levels, and are an error. Copy the file again, or make it again from its mesh.
""",
    "clean.slod: the file ends after 12 of 85 nodes; finer levels are missing.",
)
LEVELS_BOUND_NOT_PROVEN = Code(
    "levels.bound-not-proven",
    "Triangles that are not proven to be within the bound of their level",
    """
A warning. Each node states the bound that is proven for it, which is larger than that of its level here.
Views and cuts take the proven bound.
""",
    ("14 triangles have no proof of their level's bound; what is proven of their nodes is told as it is."),
)
LEVELS_MODEL_MISMATCH = Code(
    "levels.model-mismatch",
    "A model that tiles cannot get images from",
    """
The model for `--texture` has to lie where the levels lie, and needs an image or vertex colours.
""",
    "model: has neither an image nor vertex colours that tiles could get.",
)
LEVELS_TILES_TOO_FINE = Code(
    "levels.tiles-too-fine",
    "Levels that are too fine for tiles",
    """
Positions of tiles have single precision. A model that is large and finely detailed at once needs coarser
finest levels (`lod.base_error`).
""",
    (
        "vertices crowd too close for tiles, whose positions have single precision; build the levels with a "
        "larger base_error."
    ),
)
LEVELS_LEFT_OUT = Code(
    "levels.left-out",
    "Attributes that levels leave out",
    """
Warnings. Normals and parts are left out; the image of a mesh is at the end of its file, and comes back
with `--texture` if that is lost. Images of tiles are opaque.
""",
    "lod left out: parts, normals of corners.",
)
LEVELS_ISLANDS_DROPPED = Code(
    "levels.islands-dropped",
    "Small components that are dropped",
    """
Small components are dropped only with `lod.drop_islands`, and then nothing is proven of them. A length
that would drop all of the mesh is refused.
""",
    (
        "20 loose pieces smaller than 0.1 m, of 1,600 triangles, were dropped: of what the mesh has there, "
        "nothing is proven."
    ),
)
