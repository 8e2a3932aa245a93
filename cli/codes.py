"""Codes of the diagnostics of the command line."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

BATCH_OPTIONS_CONFLICT = Code(
    "batch.options-conflict",
    "Options that conflict",
    """
Exit code 2: nothing was done yet.
""",
    "--jobs is 0; it must be a number from 1 to 1024, or auto.",
)
SIMPLIFY_FILE_LARGER = Code(
    "simplify.file-larger",
    "Output file larger than its input",
    """
A warning: OUT has the same format as IN, but is larger. Images that are baked again may take as many bytes
as the removed triangles take without compression, so a compressed file can grow if few triangles are removed.
Other programs also pack normals and texture coordinates in fewer bits. `--keep-uv` keeps the images
unchanged, a smaller `--ratio` removes more triangles, and `scanloom export OUT small.glb --preset web`
compresses the file. An OBJ, OFF or ASCII PLY file can grow because coordinates are written
with all their digits.
""",
    "light.glb: larger than the input, 549,856 bytes instead of 542,144.",
)
MACHINE_LIBRARY_WARNING = Code(
    "machine.library-warning",
    "Warning of a library",
    """
A library that scanloom uses, or Python itself, issued a warning, usually about a number that could not be
computed. Please report it together with the output of `--debug`.
""",
    "RuntimeWarning: invalid value encountered in divide",
)
USAGE_OPTION_INVALID = Code(
    "usage.option-invalid",
    "Unknown option or invalid value",
    """
The command line could not be understood: an option or command is misspelled, an argument is missing, or a
value is not a number. `scanloom COMMAND --help` lists the options of a command with their units and ranges.
""",
    "No such option: --voxelsize Did you mean --voxel-size? See `scanloom fuse --help`.",
)
