"""Codes of the diagnostics of the command line."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

BATCH_OPTIONS_CONFLICT = Code(
    "batch.options-conflict",
    "Words that do not go together",
    """
Exit code 2: nothing was done yet.
""",
    "--jobs is 0; it must be a number from 1 to 1024, or auto.",
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
    "light.glb: larger than the input, 549,856 bytes instead of 542,144.",
)
MACHINE_LIBRARY_WARNING = Code(
    "machine.library-warning",
    "A warning of a library",
    """
A library that scanloom uses, or Python itself, has warned, mostly of a number that could not be computed.
Please report it together with what `--debug` adds.
""",
    "RuntimeWarning: invalid value encountered in divide",
)
USAGE_OPTION_INVALID = Code(
    "usage.option-invalid",
    "An option that does not exist, or has a wrong value",
    """
The command line could not be understood: an option or command is misspelled, an argument is missing, or a
value is not a number. `scanloom COMMAND --help` lists the options of a command with their units and ranges.
""",
    "No such option: --voxelsize Did you mean --voxel-size? See `scanloom fuse --help`.",
)
