"""Codes of the diagnostics of the command line, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

BATCH_OPTIONS_CONFLICT = Code(
    "batch.options-conflict",
    "Words that do not go together",
    """
Exit code 2: nothing was done yet.
""",
    "--jobs is …; it must be a number from 1 to 1024, or ….",
)
SIMPLIFY_FILE_LARGER = Code(
    "simplify.file-larger",
    "A file that is larger than its input",
    """
A warning: OUT has the format of IN, and takes more bytes. Images that are baked anew may take as many
bytes as the removed triangles
take without compression, so a compressed file can grow if few triangles are removed. Other programs pack
normals and texture
coordinates in fewer bits, too. `--keep-uv` keeps the images as they are, a smaller `--ratio` removes more
triangles, and
`scanloom export OUT small.glb --preset web` makes the file smaller. An OBJ, OFF or ASCII PLY file can
grow since coordinates are written
with all their digits.
""",
    "…: larger than the input, … bytes instead of ….",
)
