"""Diagnostic codes of texturing and baking, with explanations."""

from __future__ import annotations

from scanloom.stages.diagnostics.diagnostic import Code

SIMPLIFY_IMAGES_NOT_BAKED = Code(
    "simplify.images-not-baked",
    "Images that are not baked",
    """
A warning. The simplified mesh is written without the image of the original, because baking failed for the
stated reason. `scanloom mesh bake LIGHT ORIGINAL OUT.glb` may succeed with other parameters, such as a larger
`bake.max_size`.
""",
    (
        "light.glb: the image is left out; it could not be baked again: mesh: has too many charts for an "
        "image of 4096 × 4096 texels."
    ),
)
SIMPLIFY_IMAGES_SMALLER = Code(
    "simplify.images-smaller",
    "Baked images with a reduced resolution",
    """
A warning. An atlas with all detail would make the file larger than the input. `scanloom mesh bake LIGHT
ORIGINAL OUT.glb` has no such limit.
""",
    (
        "baked images have 71% of the resolution of the original images along each side, so that the file is "
        "no larger than the input."
    ),
)
TEXTURE_ATLAS_TOO_SMALL = Code(
    "texture.atlas-too-small",
    "Image too small for the charts",
    """
Every chart (a part of the surface that is flattened separately) needs some texels of padding. Use a larger
`max_size`, a larger `texel_size`, or a mesh with fewer connected components (`clean.keep_largest`). A mesh
that consists of needles cannot be laid out; clean it first.
""",
    "mesh: has too many charts for an image of 4096 × 4096 texels.",
)
TEXTURE_BAKE_LEFT_OUT = Code(
    "texture.bake-left-out",
    "Nothing to bake, or attributes that baking drops",
    """
`bake` transfers the colours of one mesh to another, so the original needs vertex colours or a texture. Baked
images are opaque. Detail finer than a texel is averaged (see `bake.texel_size`, `bake.max_size` and
`bake.max_texels`). Of MTL files, only `map_Kd` is baked.
""",
    (
        "images of 4096 × 4096 texels cannot show all detail of the original's images; finer detail is "
        "averaged. Larger values of max_texels and max_size keep more."
    ),
)
TEXTURE_PHOTOS_UNUSABLE = Code(
    "texture.photos-unusable",
    "Unusable photos",
    """
Photos that are almost completely black or overexposed, or frames without a colour image or pose. Such photos
are not used. `texture.images=FOLDER` uses photos of another camera instead.
""",
    "97% of the photo is black or white.",
)
TEXTURE_PHOTOS_INCONSISTENT = Code(
    "texture.photos-inconsistent",
    "Photos that contradict each other or the mesh",
    """
A person may have walked through the scene, the light may have changed, or a pose may be wrong. Single photos
that contradict the others are not used. If there are many, or if photos are misaligned with the mesh, check
the poses; `scanloom adjust` corrects them.
""",
    "the photo contradicts the others: the median difference is 41 levels.",
)
TEXTURE_SURFACE_UNSEEN = Code(
    "texture.surface-unseen",
    "Surface that no photo shows",
    """
A warning. Such parts of the surface keep their vertex colours, if the mesh has any. Record them as well, or
remove them with a crop.
""",
    "no photo shows 64% of the surface, which keeps its vertex colours",
)
