"""Diagnostic codes of file access, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

FILE_ARCHIVE_DAMAGED = Code(
    "file.archive-damaged",
    "Archives",
    """
`.r3d` and `.npz` are zip files. Unpacking one and packing it again (`zip -r`) brings it into a form that
can be read.
""",
    "room.r3d: the archive does not open; it is damaged or was cut short. Copy it again.",
)
FILE_DAMAGED = Code(
    "file.damaged",
    "Cut short or damaged",
    """
Copy the file again from its source. If it is one frame among many, it can also be deleted, or left out
with `scan.every`, `scan.first` and `scan.last`.
""",
    "room/color/000012.png: the image is cut short; copy it again or leave the frame out.",
)
FILE_DEPTH_FORMAT = Code(
    "file.depth-format",
    "Depth that is not depth",
    """
Depth maps are 16-bit images of one channel, `.npy`, `.pfm` or `.exr`. Images of 8 bits or of colours are
previews: 256 steps are no measurement. Export the raw depth.
""",
    "room/depth/000012.png: a depth map of one channel is expected; this is a colour image.",
)
FILE_IMAGE_FORMAT = Code(
    "file.image-format",
    "Images in a form that is not read",
    """
Convert the image: colour and masks have 8 bits a channel, and OpenEXR is read where it is a single part
of scan lines, such as with ZIP compression.
""",
    "room/rgb/000012.png: a colour image of 8 bits a channel is expected; this one is uint16.",
)
FILE_PATH_OUTSIDE = Code(
    "file.path-outside",
    "Paths that lead out of the folder",
    """
A list in the scan names a file by an absolute path or with `..`. Such a file is not read, whoever wrote
the list: put the images into the scan folder and write relative paths.
""",
    "room/rgb.txt: line 3: '../other/1.png' is not a path inside the folder.",
)
FILE_TEXT_INVALID = Code(
    "file.text-invalid",
    "Texts that do not parse",
    """
The line is named where the format has lines. YAML must be indented by spaces, not tabs; JSON has no
comments and no comma behind the last entry. Sizes are limited: a calibration of many megabytes is
refused, because it is probably something else.
""",
    "room/scan.json: it is nested more than 100 deep.",
)
FILE_UNREADABLE = Code(
    "file.unreadable",
    "The system does not let it be opened",
    """
The reason of the operating system stands in brackets: permissions, a broken link, a network drive that is
gone.
""",
    "room/depth/000012.png: the file cannot be read (Permission denied).",
)
FILE_PATH_INVALID = Code(
    "file.path-invalid",
    "A path that is not there, or of the wrong kind",
    """
Exit code 3. Check the spelling, and that a relative path begins at the current folder of the shell. Names
with spaces need quotes.
""",
    "rooom.ply: there is no such file or folder.",
)
FILE_OUTPUT_REFUSED = Code(
    "file.output-refused",
    "An output path that may not be written, or that holds something else",
    """
Nothing that scanloom has not written itself is replaced in an output folder: move it, name another
folder, or let `--overwrite` replace it. Where a permission is missing, `ls -l` shows the owner of the
file.
""",
    "/srv/out: the permission is missing",
)
RECORDING_DAMAGED = Code(
    "recording.damaged",
    "Cut short or damaged",
    """
Copy the file again and compare its size with the original. Of a recording that was not closed, the part
before the damage is used, with a warning; ROS's own tools can write such a file anew (`rosbag reindex`,
`ros2 bag reindex`, `mcap recover`).
""",
    "room.bag: its record at byte 81920 of 90112 is damaged or cut short",
)
