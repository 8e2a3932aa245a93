"""Diagnostic codes that are not specific to a stage, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

MACHINE_BUG = Code(
    "machine.bug",
    "A bug",
    """
Run the same command with `--debug`, which prints the traceback. Report it with the output of `scanloom doctor
--bundle bug.zip --run OUT`: versions, machine and metrics of the run, no images. A bug report is also welcome
if the input is damaged.
""",
    (
        "This is a bug in scanloom (IndexError: list index out of range). Please report it with "
        "the output of --debug."
    ),
)
MACHINE_LIBRARY_MISSING = Code(
    "machine.library-missing",
    "A library that is missing",
    """
The message names the library, and its package on Debian and Ubuntu. `scanloom doctor` lists the installed
libraries.
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
Two runs into one folder take turns: the second one waits. If a file changes while it is read, the scan is
still being copied or recorded. Run again when it is complete.
""",
    "kitchen/depth/000123.png changed while it was being read; run again when it is complete.",
)
MACHINE_OUT_OF_MEMORY = Code(
    "machine.out-of-memory",
    "No memory",
    """
Exit code 1. Most memory of a run is used by:

- The volume of `fuse`. Twice the `fuse.voxel_size` needs about a quarter of the memory, and `fuse.max_depth`
  excludes distant surfaces. `fuse.memory` limits the volume: a larger one is split into bricks of
  `fuse.brick_size`. Fusion only fails if a single brick exceeds the limit.
- Stereo pairs that `depth` processes at the same time (`depth.threads=1`).
- Large textures (`texture.max_size`).

`scanloom run --dry-run` estimates the required memory.
""",
    "fuse failed: the memory is used up.",
)
MACHINE_DISK_FAILED = Code(
    "machine.disk-failed",
    "A full or failing disk",
    """
Exit code 1. Finished stages stay in the cache. `scanloom cache prune --max-size "5 GB"` frees space.
`SCANLOOM_CACHE` or `--set run.cache=DIR` put the cache on another disk, and `TMPDIR` the temporary depth
maps. Results are written atomically, so a full disk leaves no partial files.
""",
    "the disk is full; free some space and run again",
)
CONFIG_UNREADABLE = Code(
    "config.unreadable",
    "A configuration file that cannot be read",
    """
`--config` takes a TOML file: sections in brackets, and one parameter per line below them. `scanloom config >
run.toml` writes a template.
""",
    ("scan.toml: this is not TOML (Expected '=' after a key in a key/value pair (at line 3, column 8))."),
)
CONFIG_PARAMETER_UNKNOWN = Code(
    "config.parameter-unknown",
    "A section or parameter that does not exist",
    """
`scanloom config` prints every section and parameter as TOML. The message suggests the most similar name.
""",
    "scan.toml: fuse has no parameter 'voxelsize'; did you mean fuse.voxel_size?",
)
USAGE_VALUE_INVALID = Code(
    "usage.value-invalid",
    "A value of the wrong type, or out of its range",
    """
The message gives the parameter, the value, and the allowed range in the parameter's unit; lengths are in
metres. In a shell, quote values with spaces or asterisks. `none` resets a parameter to its derived value.
""",
    "--voxel-size is 0 m; it must be more than 0 m.",
)
USAGE_ARGUMENT_INVALID = Code(
    "usage.argument-invalid",
    "Invalid arguments of Python functions",
    """
Raised for arrays of inconsistent shapes, among others. Meshes have `vertices` (n, 3) in metres, `triangles`
(m, 3) of integers, and `colors` (n, 3) of uint8; [the reference](../reference/python.md) has the shapes of
all other arguments.
""",
    "left and right are of different sizes: 640×480 and 320×240.",
)
USAGE_OPTIONS_CONFLICT = Code(
    "usage.options-conflict",
    "Options that require or exclude each other",
    """
One of the two options has no effect without the other, or cannot be combined with it. The help of the command
explains each option.
""",
    "--save-change needs --change.",
)
