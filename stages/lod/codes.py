"""Codes of the diagnostics of levels of detail, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

LEVELS_FILE_DAMAGED = Code(
    "levels.file-damaged",
    "Files that are damaged",
    """
Make it again from its mesh.
""",
    "…: this is no .slod file.",
)
LEVELS_TILES = Code(
    "levels.tiles",
    "Tiles",
    """
Positions of tiles have single precision. A model that is large and finely detailed at once needs coarser
finest levels
(`lod.base_error`). The model for `--texture` has to lie where the levels lie.
""",
    (
        "vertices crowd too close for tiles, whose positions have single precision; "
        "build the levels with a larger base_error."
    ),
)
LEVELS_LEFT_OUT = Code(
    "levels.left-out",
    "What levels leave out",
    """
Warnings. Normals and parts are left out; the image of a mesh is at the end of its file, and comes back
with `--texture` if that
is lost. Loose pieces go only with `lod.drop_islands`, and then nothing is proven of them.
""",
    (
        "… loose pieces smaller than … m, of … triangles, were dropped: of what the "
        "mesh has there, nothing is proven."
    ),
)
