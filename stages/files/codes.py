"""Diagnostic codes of file access, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

FILE_ARCHIVE_DAMAGED = Code(
    "file.archive-damaged",
    "Unreadable archives",
    """
`.r3d` and `.npz` are ZIP files. If an entry has an unsupported compression method, unpack the archive and
pack it again with `zip -r`.
""",
    "room.r3d: the archive does not open; it is damaged or was cut short. Copy it again.",
)
FILE_DAMAGED = Code(
    "file.damaged",
    "Damaged or truncated files",
    """
Copy the file again from its source. If it belongs to one frame among many, it can also be deleted, or the
frame can be excluded with `scan.every`, `scan.first` and `scan.last`.
""",
    "room/color/000012.png: the image is cut short; copy it again or leave the frame out.",
)
FILE_DEPTH_FORMAT = Code(
    "file.depth-format",
    "Depth maps in a wrong format",
    """
Depth maps are single-channel 16-bit images, `.npy`, `.pfm` or `.exr`. 8-bit and colour images are previews:
their 256 levels are too coarse for depth. Export the raw depth.
""",
    "room/depth/000012.png: a single-channel depth map is expected; this is a colour image.",
)
FILE_IMAGE_FORMAT = Code(
    "file.image-format",
    "Images in an unsupported format",
    """
Convert the image. Colour images and masks need 8 bits per channel. OpenEXR files need a single part with
scan lines, for example with ZIP compression.
""",
    "room/rgb/000012.png: a colour image with 8 bits per channel is expected; this one is uint16.",
)
FILE_PATH_OUTSIDE = Code(
    "file.path-outside",
    "Paths outside the scan folder",
    """
A list in the scan names a file by an absolute path or with `..`. For security, scanloom does not read such
files. Put the images into the scan folder and write relative paths.
""",
    "room/rgb.txt: line 3: '../other/1.png' is not a path inside the folder.",
)
FILE_TEXT_INVALID = Code(
    "file.text-invalid",
    "Text files that do not parse",
    """
The message gives the line if the format has lines. YAML must be indented with spaces, not tabs. JSON has no
comments, and no comma after the last entry. The file size is limited, because a calibration of many
megabytes is probably another kind of file.
""",
    "room/scan.json: the file is not valid JSON (line 12).",
)
FILE_UNREADABLE = Code(
    "file.unreadable",
    "Files that the system cannot open",
    """
The reason of the operating system is in brackets: missing permissions, a broken link, or a network drive that
is not available.
""",
    "room/depth/000012.png: the file cannot be read (Permission denied).",
)
FILE_PATH_INVALID = Code(
    "file.path-invalid",
    "A path that does not exist, or is of the wrong kind",
    """
Exit code 3. Check the spelling. A relative path starts at the current folder of the shell. Names with spaces
need quotes.
""",
    "rooom.ply: there is no such file or folder.",
)
FILE_OUTPUT_REFUSED = Code(
    "file.output-refused",
    "An output path that cannot be written or replaced",
    """
Only output folders that scanloom has written are replaced. Move the existing folder, choose another
one, or allow replacing it with `--set run.overwrite=true`. If a permission is missing, `ls -l` shows the
owner of the file.
""",
    "/srv/out: the permission is missing",
)
RECORDING_DAMAGED = Code(
    "recording.damaged",
    "Damaged or truncated recordings",
    """
Copy the file again and compare its size with the original. If a recording was not closed properly, the part
before the damage is used, with a warning. ROS's own tools can repair such a file (`rosbag reindex`,
`ros2 bag reindex`, `mcap recover`).
""",
    "room.bag: its record at byte 81920 of 90112 is damaged or cut short",
)
FILE_TEXTURE_ENCODER_MISSING = Code(
    "file.texture-encoder-missing",
    "Missing encoder of KTX2 images",
    """
KTX2 images are encoded and decoded by the Node package `ktx2-encoder`. Install Node 20 or later, then run
`npm install --global ktx2-encoder`. Without a global installation, set the environment variable `NODE_PATH`
to the folder `node_modules` that contains the package. KTX2 images of a mesh can be copied to another glTF
file without the package.
""",
    (
        "KTX2 images require the Node package ktx2-encoder; run `npm install --global ktx2-encoder`, or set "
        "NODE_PATH to the `node_modules` that has it."
    ),
)
FILE_TEXTURE_ENCODER_FAILED = Code(
    "file.texture-encoder-failed",
    "KTX2 images that cannot be encoded",
    """
The Node package `ktx2-encoder` is too old, ran out of memory, or needed more than an hour. The message quotes
its error. Update the package, or write WebP images.
""",
    (
        "ktx2-encoder could not encode an image of 2048 × 1024 texels (Error: version 0.5.1 of ktx2-encoder "
        "is too old); update it with `npm install --global ktx2-encoder`, or write WebP."
    ),
)
