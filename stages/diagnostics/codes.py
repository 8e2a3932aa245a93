"""Codes of the diagnostics of all rooms, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

MACHINE_BUG = Code(
    "machine.bug",
    "A bug",
    """
Run the same command with `--debug`, which shows where it happened, and report that with
`scanloom doctor --bundle bug.zip --run OUT`: versions, machine and figures of the run, no images. Damaged
input that
ends so is a bug, too.
""",
    (
        "This is a bug in scanloom (IndexError: list index out of range). Please report it with "
        "what --debug adds to the same command."
    ),
)
MACHINE_LIBRARY_MISSING = Code(
    "machine.library-missing",
    "A library that is missing",
    """
The sentence names the library, and on Debian and Ubuntu its package. `scanloom doctor` tells what is there.
""",
    (
        "Open3D cannot be imported: the system library libGL.so.1 is missing. On Debian and Ubuntu:"
        " apt-get install libgl1."
    ),
)
MACHINE_BUSY = Code(
    "machine.busy",
    "Another run, or a scan that is still being written",
    """
Two runs into one folder take turns: the second waits. A file that changes while it is read belongs to a
scan that is
still being copied or recorded: run again when it is complete.
""",
    "kitchen/depth/000123.png changed while it was being read; run again when it is complete.",
)
MACHINE_OUT_OF_MEMORY = Code(
    "machine.out-of-memory",
    "No memory",
    """
Exit code 1. What takes memory is, in a run, the volume of `fuse` (twice the `fuse.voxel_size` takes about
a quarter of
it; `fuse.max_depth` leaves out what is far, and `fuse.memory` is how large it may get: beyond that, space
is cut in bricks of
`fuse.brick_size`, and only if one of them alone is too large does fusion stop), the pairs that `depth`
works on
at the same time (`depth.threads=1`), and large textures (`texture.max_size`). `scanloom run --dry-run`
tells how much
to expect.
""",
    "fuse failed: the memory is used up.",
)
MACHINE_DISK_FAILED = Code(
    "machine.disk-failed",
    "The disk",
    """
Exit code 1; what was finished is kept. `scanloom cache prune --max-size "5 GB"` makes room,
`SCANLOOM_CACHE` or
`--cache` put the cache on another disk, and `TMPDIR` the maps of single views. Results appear whole or
not at all, so a
full disk leaves no half files.
""",
    "the disk is full; free some space and run again",
)
CONFIG_UNREADABLE = Code(
    "config.unreadable",
    "A configuration file that cannot be read",
    """
`--config` takes TOML: a section in brackets, and under it one parameter a line. `scanloom config >
run.toml` writes one
to begin with.
""",
    ("scan.toml: this is not TOML (Expected '=' after a key in a key/value pair (at line 3, column 8))."),
)
CONFIG_PARAMETER_UNKNOWN = Code(
    "config.parameter-unknown",
    "A section or parameter that does not exist",
    """
`scanloom config` prints every section and parameter as TOML. What comes nearest to the word that was
given is named.
""",
    "scan.toml: fuse has no parameter 'voxelsize'; did you mean fuse.voxel_size?",
)
USAGE_VALUE_INVALID = Code(
    "usage.value-invalid",
    "A value of the wrong kind, or out of its range",
    """
The sentence names the parameter, what was given, and what is allowed, in the parameter's unit: lengths
are metres. In a
shell, quote what has spaces or stars. `none` gives a parameter that is derived from the data back to
being derived.
""",
    "--voxel-size is 0 m; it must be more than 0 m.",
)
USAGE_ARGUMENT_INVALID = Code(
    "usage.argument-invalid",
    "Arguments of functions in Python",
    """
Raised where arrays do not fit each other. Meshes have `vertices` (n, 3) in metres, `triangles` (m, 3) of
whole numbers,
and `colors` (n, 3) of uint8; [the reference](../reference/python.md) has the shape of everything else.
""",
    "left and right are of different sizes: 640×480 and 320×240.",
)
USAGE_OPTIONS_CONFLICT = Code(
    "usage.options-conflict",
    "Options that need each other, or exclude each other",
    """
One of the two options has no meaning without, or beside, the other. The help of the command says what
each is for.
""",
    "--save-change needs --change.",
)
