"""Codes of the diagnostics of fusion, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

FUSE_DEVICE_MISSING = Code(
    "fuse.device-missing",
    "A graphics card that is not there",
    """
`fuse.device=cpu` always works; `auto` takes CUDA where Open3D finds it. Only Open3D's voxels work there:
leave `fuse.backend` at `auto`, or set it to `open3d`.
""",
    "fuse.device is 'cuda', but Open3D finds no CUDA device; choose cpu or auto.",
)
FUSE_BRICK_DAMAGED = Code(
    "fuse.brick-damaged",
    "Bricks that are damaged or do not fit each other",
    """
Where space is cut in bricks (`fuse.brick_size`, or by itself where memory would not be enough), each
brick is kept in the cache. If bricks do not fit each other, somebody changed one; `scanloom cache verify`
finds it. Bricks that are damaged before a run looks for them are reported and made anew.
""",
    "pieces of the surface do not fit each other; fuse again, with --set run.force=fuse.",
)
FUSE_FAR_DEPTH_LEFT_OUT = Code(
    "fuse.far-depth-left-out",
    "Far depth that is left out",
    """
A warning. The voxel size follows from the depth at which most of the scene lies. Noise grows with the
square of the distance; depth so far away that voxels of this size would give shreds of it is left out: a
room behind a desk, say. If the far parts matter, give the parameter that is named: they are fused then,
and the near parts are coarser. `fuse.max_depth` states a limit, and silences the warning.
""",
    (
        "12% of the depth is beyond 2.35 m and not fused: its noise there is more than voxels of 0.004 m can "
        "take. fuse.truncation=0.08 takes in what is up to 3.10 m away"
    ),
)
FUSE_FRAMES_FAR_APART = Code(
    "fuse.frames-far-apart",
    "Frames far apart",
    """
Voxels are counted around the cameras, to 8 million either way: 84 km at 1 cm. One of the poses is wrong,
or lengths are in another unit than metres; `scanloom inspect SCAN` shows the extent of the poses.
""",
    (
        "a frame shows places more than 84 km from the other cameras, farther than "
        "voxels of 0.01 m are counted. Check the poses, or give a larger voxel_size."
    ),
)
FUSE_NO_SURFACE = Code(
    "fuse.no-surface",
    "No surface",
    """
Depth and poses were read, but no voxel was seen by enough frames. Poses that are inverted scatter the
depth; a wrong depth unit puts it out of reach; `fuse.max_depth` may be smaller than the distance. Look at
`scanloom inspect SCAN --picture P.png`, then lower `fuse.min_weight`.
""",
    (
        "scans/desk: no surface came out of 24 frames at voxels of 0.004 m: none was seen by 3 of them. "
        "Check poses and depth scale, or lower min_weight."
    ),
)
FUSE_CROP_EMPTY = Code(
    "fuse.crop-empty",
    "Nothing left of a crop",
    """
The box or the centre lies where the scan is not, most often in another unit or with axes exchanged:
`scanloom inspect SCAN` shows the corners of the scan and the point that its cameras look at. Disconnected
pieces of a scan have coordinate systems of their own, and a box is in none of them.
""",
    (
        "nothing is left to fuse: of 412,300 points in 24 frames 0 are inside the box (5, 5, 5) to (6, 6, 6) "
        "m; most lie within (-1.2, -0.8, 0.1) to (1.4, 0.9, 2.2) m."
    ),
)
FUSE_PLANE_UNCERTAIN = Code(
    "fuse.plane-uncertain",
    "The plane under an object is not found, or doubtful",
    """
A warning. `remove_plane` needs a plane under the object that is seen well, such as a table. Where the
largest plane is a wall or the floor, `center` and `radius`, or a `box`, say where the object is.
""",
    (
        "remove_plane: nothing is removed, no plane under the thing is found: the plane of 61% of the points "
        "has nothing standing on it; center, box or radius say where the thing is"
    ),
)
