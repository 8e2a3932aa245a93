"""Diagnostic codes of fusion, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

FUSE_DEVICE_MISSING = Code(
    "fuse.device-missing",
    "CUDA device not found",
    """
`fuse.device=cpu` always works; `auto` uses CUDA if Open3D finds a device. Only the Open3D backend supports
CUDA: leave `fuse.backend` at `auto`, or set it to `open3d`.
""",
    "fuse.device is 'cuda', but Open3D finds no CUDA device; set it to cpu or auto.",
)
FUSE_BRICK_DAMAGED = Code(
    "fuse.brick-damaged",
    "Damaged or mismatching bricks",
    """
Large scans are fused in bricks: with `fuse.brick_size`, or automatically if memory does not suffice. Each
brick is stored in the cache. If the meshes of adjacent bricks do not match, a cached file was modified;
`scanloom cache verify` finds it. A brick that is damaged before a run starts is reported and fused anew.
""",
    "the meshes of adjacent bricks do not match; run again with --force fuse.",
)
FUSE_FAR_DEPTH_LEFT_OUT = Code(
    "fuse.far-depth-left-out",
    "Far depth is ignored",
    """
A warning. The voxel size is derived from the median depth of the scene. Depth noise grows with the square
of the distance, and voxels of this size would turn very far depth into fragments, such as a room behind a
desk. Such depth is ignored. To include it, set the parameter in the message; close surfaces then get
coarser. `fuse.max_depth` sets a limit explicitly, and silences the warning.
""",
    (
        "12% of the depth lies beyond 2.35 m and is ignored, because its noise is too high for voxels of "
        "0.004 m. fuse.truncation=0.08 includes depth up to 3.10 m"
    ),
)
FUSE_FRAMES_FAR_APART = Code(
    "fuse.frames-far-apart",
    "Frames too far apart",
    """
Voxel coordinates range to ±8 million around the cameras: 84 km at 1 cm. A pose is wrong, or lengths are not
in metres. `scanloom inspect SCAN` shows the extent of the poses.
""",
    (
        "a frame has points more than 84 km from the other cameras, beyond the range of voxels "
        "of 0.01 m. Check the poses, or increase voxel_size."
    ),
)
FUSE_NO_SURFACE = Code(
    "fuse.no-surface",
    "Empty mesh",
    """
Depth and poses were read, but no voxel was observed by enough frames. Possible causes: inverted poses,
which scatter the depth; a wrong depth unit; a `fuse.max_depth` below the distance of the scene. View the
points with `scanloom inspect SCAN --picture P.png`. If they are right, lower `fuse.min_weight`.
""",
    (
        "scans/desk: the mesh is empty: no voxel of 0.004 m was observed by at least 3 of 24 frames. "
        "Check the poses and the depth scale, or lower min_weight."
    ),
)
FUSE_CROP_EMPTY = Code(
    "fuse.crop-empty",
    "Empty crop",
    """
The scan has no points inside the box or around the centre. Most often the unit is wrong, or axes are
swapped: `scanloom inspect SCAN` shows the corners of the scan and the point its cameras look at.
Disconnected components of a scan have separate coordinate systems, so that a box does not apply to them.
""",
    (
        "the crop is empty: none of 412,300 points in 24 frames is inside the box (5, 5, 5) to (6, 6, 6) m; "
        "most points are within (-1.2, -0.8, 0.1) to (1.4, 0.9, 2.2) m."
    ),
)
FUSE_PLANE_UNCERTAIN = Code(
    "fuse.plane-uncertain",
    "Support plane not found or uncertain",
    """
A warning. `remove_plane` requires a clearly visible plane under the object, such as a table. If the largest
plane is a wall or the floor, give the position of the object with `center` and `radius`, or with `box`.
""",
    (
        "remove_plane: no plane is removed, because none was found under the object: the largest plane "
        "(61% of the points) has no points above it; give the position of the object with center, radius "
        "or box"
    ),
)
