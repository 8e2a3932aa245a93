"""Codes of the diagnostics of texturing and baking, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

SIMPLIFY_IMAGES_NOT_BAKED = Code(
    "simplify.images-not-baked",
    "Images that are not baked",
    """
A warning. An atlas has as many texels as the images that it replaces: one brick that repeats over a wall,
or a palette of colours, has too few. Seams then stay, and hold the shape in place; `--bake` bakes
regardless. A larger image comes from `scanloom bake LIGHT ORIGINAL OUT.glb`, which has no limit of bytes.
""",
    (
        "the images repeat on the surface: texture coordinates and images are kept, "
        "since an atlas of as few texels would lose detail; bake=True makes one all "
        "the same."
    ),
)
SIMPLIFY_IMAGES_SMALLER = Code(
    "simplify.images-smaller",
    "Images that are baked smaller",
    """
A warning. An atlas that shows all detail would make the file larger than the input. `scanloom bake LIGHT
ORIGINAL OUT.glb` has no limit of bytes.
""",
    (
        "baked images have 71% of the resolution of the old ones along each side, so that the file is no "
        "larger than the input."
    ),
)
TEXTURE_ATLAS_TOO_SMALL = Code(
    "texture.atlas-too-small",
    "Images that are too small, or too many charts",
    """
Every chart needs some texels beside it. Give a larger `max_size`, a larger texel, or a mesh in fewer
connected components (`clean.keep_largest`). A mesh of needles alone cannot be laid out: clean it first.
""",
    "mesh: falls into too many pieces for an image of 4096 × 4096 texels.",
)
TEXTURE_BAKE_LEFT_OUT = Code(
    "texture.bake-left-out",
    "Nothing to bake, or something that baking leaves out",
    """
`bake` brings the colours of one mesh to another one: the original needs vertex colours or a texture.
Baked images are opaque; detail finer than a texel is averaged (`bake.texel_size`, `bake.max_size`). Maps of
MTL files other than `map_Kd` have no place in the atlas.
""",
    "bake left out: detail of the original's images that 4096 × 4096 texels cannot show.",
)
TEXTURE_PHOTOS_UNUSABLE = Code(
    "texture.photos-unusable",
    "Photos that cannot be used",
    """
Black or burnt-out images, frames without colour or pose. `texture.images=FOLDER` takes photos of another
camera.
""",
    "97% of the photo is black or white.",
)
TEXTURE_PHOTOS_INCONSISTENT = Code(
    "texture.photos-inconsistent",
    "Photos that contradict the others, or the mesh",
    """
Somebody stood in the picture, a light was switched, or the pose is wrong. Single photos that differ are
left out. If many are, or a warning says that all photos are off the mesh, look at the poses; `scanloom
adjust` corrects them.
""",
    "its photo shows something else than the others: 41 levels difference in the median.",
)
TEXTURE_SURFACE_UNSEEN = Code(
    "texture.surface-unseen",
    "Surface that no photo shows",
    """
A warning. Such surface keeps the mesh's own colours where there are some. Record it too, or leave it out
with a crop.
""",
    "64% of the surface is in no photo and has the mesh's own colours",
)
