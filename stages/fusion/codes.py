"""Codes of the diagnostics of fusion, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

FUSE_DEVICE_MISSING = Code(
    "fuse.device-missing",
    "A graphics card that is not there",
    """
`fuse.device=cpu` always works; `auto` takes CUDA where Open3D finds it. Only Open3D's voxels work there:
leave `fuse.backend`
to `auto`, or set it to `open3d`.
""",
    "device is 'cuda', but Open3D finds no CUDA device; choose cpu or auto.",
)
FUSE_BRICKS = Code(
    "fuse.bricks",
    "Bricks",
    """
Where space is cut in bricks (`fuse.brick_size`, or by itself where memory would not do), each is kept in
the cache. If they do not
fit each other, somebody changed one; `scanloom cache verify` tells which. What is damaged before a run
looks for it is told,
and made anew by itself.
""",
    "brick_size is for scanloom's own voxels; leave out device and backend.",
)
FUSE_FAR_DEPTH_LEFT_OUT = Code(
    "fuse.far-depth-left-out",
    "Far depth that is left out",
    """
Voxels follow from the depth at which most of the scene lies. Noise grows with the square of the distance,
and what is so far that
voxels of this size would give shreds of it is left out: a room behind a desk, say. Where that matters,
give the voxel size that
is named: the far parts come, and the near ones are coarser. `fuse.max_depth` states a limit, and the
warning is gone.
""",
    (
        "… of the depth is beyond … m and not fused: its noise there is more than "
        "voxels of … m can take. fuse.… takes in what is up to … m away"
    ),
)
FUSE_FRAMES_FAR_APART = Code(
    "fuse.frames-far-apart",
    "Frames far apart",
    """
Voxels are counted around the cameras, to 8 million either way: 84 km at 1 cm. One pose among the others
is wrong, or lengths
are in another unit than metres; `scanloom inspect SCAN` tells the extent of the poses.
""",
    (
        "a frame shows places more than … km from the other cameras, farther than "
        "voxels of … m are counted. Check the poses, or give a larger voxel_size."
    ),
)
FUSE_NO_SURFACE = Code(
    "fuse.no-surface",
    "No surface",
    """
Depth and poses were read, but no voxel was seen by enough frames. Poses that are inverted scatter the
depth; a wrong
depth unit puts it out of reach; `fuse.max_depth` may be smaller than the distance. Look at
`scanloom inspect SCAN --picture P.png`, then lower `fuse.min_weight`.
""",
    "none of the … frames has a depth map; compute depth from stereo pairs first.",
)
FUSE_CROP_EMPTY = Code(
    "fuse.crop-empty",
    "Nothing left of a crop",
    """
A box or a centre that lies where the scan is not, most often in another unit or with axes exchanged:
`scanloom inspect SCAN`
tells the corners of the scan and what its cameras look at. `remove_plane` wants a plane under the thing
that is seen well,
such as a table; where the largest one is a wall, `center` and `radius` say where the thing is. Pieces of
a scan that were not
joined have places of their own, and a box is in none of them.
""",
    (
        "remove_plane: nothing is removed, no plane under the thing is found: …; "
        "center, box or radius say where the thing is"
    ),
)
