"""Codes of the diagnostics of texturing and baking, with explanations."""

from __future__ import annotations

from stages.diagnostics.diagnostic import Code

SIMPLIFY_IMAGES_NOT_BAKED = Code(
    "simplify.images-not-baked",
    "Images that are not baked, or baked smaller",
    """
Warnings but for the last two, which end the command. An atlas has as many texels as the images that it
replaces: one brick that
repeats over a wall, or a palette of colours, has too few. Seams then stay, and hold the shape in place;
`--bake` bakes
regardless. Maps of MTL files other than `map_Kd` have no place in the atlas. A larger image comes from
`scanloom bake LIGHT ORIGINAL OUT.glb`, which has no limit of bytes.
""",
    (
        "the images repeat on the surface: texture coordinates and images are kept, "
        "since an atlas of as few texels would lose detail; bake=True makes one all "
        "the same."
    ),
)
TEXTURE_ATLAS_TOO_SMALL = Code(
    "texture.atlas-too-small",
    "Images that are too small, or pieces too many",
    """
Every chart needs some texels beside it. Give a larger `max_size`, a larger texel, or a mesh in fewer pieces
(`clean.keep_largest`). A mesh of needles alone cannot be laid out: clean it first.
""",
    "falls into too many pieces for an image of … × … texels.",
)
TEXTURE_BAKE_LEFT_OUT = Code(
    "texture.bake-left-out",
    "Nothing to bake, or what baking leaves out",
    """
`bake` brings the colours of one mesh to another one: the original needs vertex colours or a texture.
Images are opaque;
detail finer than a texel is averaged (`--texel-size`, `--max-size`).
""",
    "bake left out: detail of the original's images that … texels cannot show.",
)
TEXTURE_PHOTOS_UNUSABLE = Code(
    "texture.photos-unusable",
    "Photos that cannot be used",
    """
Black or burnt-out images, frames without colour or pose. `texture.images=FOLDER` takes photos of another
camera.
""",
    "… of the photo is black or white.",
)
TEXTURE_PHOTOS_INCONSISTENT = Code(
    "texture.photos-inconsistent",
    "Photos that show something else than the others",
    """
Somebody stood in the picture, a light was switched, or the pose is wrong. Such photos are left out; if
many are, look
at the poses.
""",
    "its photo shows something else than the others: … levels difference in the median.",
)
TEXTURE_SURFACE_UNSEEN = Code(
    "texture.surface-unseen",
    "Surface that no photo shows",
    """
A warning. It keeps the mesh's own colours where there are some. Record it too, or leave it out with a crop.
""",
    "… of the surface is in no photo and has …",
)
